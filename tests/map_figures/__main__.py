"""`python -m tests.map_figures MODULE ...`: prints tables about positions, matching and lanes.

`outages` is how right the lane is where lines are missing, with and without positions; `located`
what it costs that the road is found from positions; `matched` how often the right segment is found;
`recorded` what two recorded drives tell. All but `outages` need EGOLANE_DATA, which it too takes
recorded noise from.
"""

from __future__ import annotations

import argparse
import importlib

MODULES = ("outages", "located", "matched", "recorded")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.map_figures", description=__doc__)
    parser.add_argument("modules", nargs="+", choices=MODULES)
    for name in parser.parse_args().modules:
        for line in importlib.import_module(f"{__package__}.{name}").measure():
            print(line, flush=True)


main()
