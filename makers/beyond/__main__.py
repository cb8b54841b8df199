"""`python -m makers.beyond PAGE`: print a page about drives that nobody tuned on.

`strangers` is the accuracy of the model without labels on the ten recordings as other detectors
might have written them (ten minutes of one core), `sensors` the same for sensors that report less,
`ramps` lane changes next to an entry ramp (simulated, two minutes). All but `ramps` need
EGOLANE_DATA.
"""

from __future__ import annotations

import argparse
import importlib


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.beyond", description=__doc__)
    parser.add_argument("page", choices=("ramps", "sensors", "strangers"))
    page = parser.parse_args().page
    for line in importlib.import_module(f"{__package__}.{page}").measure():
        print(line, flush=True)


main()
