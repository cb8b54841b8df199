"""`python -m makers.camera [MODULE ...]`: print results/camera/pictures.md, or parts of it.

A module defines `measure()`, which returns lines of Markdown, and may define `draw(folder)`.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

#: In the order of the page.
MODULES = ("carnd", "tusimple", "phantom", "clips", "aly", "drift", "lane_change", "lstr")


def main() -> None:
    """Print the sections of the modules that are named, or of all."""
    parser = argparse.ArgumentParser(prog="python -m makers.camera", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(MODULES))
    parser.add_argument("--out", type=Path, help="folder for the figures")
    options = parser.parse_args()
    for name in options.modules or MODULES:
        module = importlib.import_module(f"makers.camera.{name}")
        print("\n".join([*module.measure(), ""]), flush=True)
        if options.out and hasattr(module, "draw"):
            module.draw(options.out)


main()
