"""`python -m makers.maps MODULE ...`: prints tables about positions, matching and lanes.

`changes` is how right the lane is where lanes begin and end, `wrong_counts` how often a map that is
wrong by a lane is found; `outages` how right the lane is where lines are missing, with and without
positions; `located` what it costs that the road is found from positions; `matched` how often the
right segment is found; `recorded` what two recorded drives tell; `receivers` what real positions
add to lines. All but `wrong_counts` need
EGOLANE_DATA: maps, or recorded noise.
"""

from __future__ import annotations

import argparse
import importlib

MODULES = ("changes", "wrong_counts", "outages", "located", "matched", "recorded", "receivers")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.maps", description=__doc__)
    parser.add_argument("modules", nargs="+", choices=MODULES)
    for name in parser.parse_args().modules:
        for line in importlib.import_module(f"{__package__}.{name}").measure():
            print(line, flush=True)


main()
