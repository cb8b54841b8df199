"""`python -m makers.maps MODULE ...`: prints tables about positions, matching and lanes.

`changes` is how right the lane is where lanes begin and end, `matched` how often the right segment
is found, `receivers` what real positions add to lines. All need EGOLANE_DATA.
"""

from __future__ import annotations

import argparse
import importlib

MODULES = ("changes", "matched", "receivers")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.maps", description=__doc__)
    parser.add_argument("modules", nargs="+", choices=MODULES)
    for name in parser.parse_args().modules:
        for line in importlib.import_module(f"{__package__}.{name}").measure():
            print(line, flush=True)


main()
