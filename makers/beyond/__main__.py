"""`python -m makers.beyond MODULE [--out DIR] ...`: figures about drives not seen.

`strangers` prints how often the model without labels is right on the ten recordings as other
detectors might have written them (about ten minutes of one core; --only and --runs take less),
`sensors` the same of sensors that give less, `failures` where it fails on run 5 and why, and draws
it, `ramps` lane changes where a ramp joins (simulated, two minutes). All but `ramps` need
EGOLANE_DATA.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from egolane_pgm.paper import parse_runs

MODULES = ("failures", "ramps", "sensors", "strangers")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.beyond", description=__doc__)
    parser.add_argument("module", choices=MODULES)
    parser.add_argument("--out", type=Path, help="folder for pictures")
    parser.add_argument("--runs", default="1-10", help="runs of the paper, e.g. 1,5,10")
    parser.add_argument("--only", default="", help="strangers whose name has this in it")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    module = importlib.import_module(f"{__package__}.{options.module}")
    for line in module.measure(parse_runs(options.runs), options.only, options.set):
        print(line, flush=True)
    if options.out and hasattr(module, "draw"):
        options.out.mkdir(parents=True, exist_ok=True)
        module.draw(options.out)


main()
