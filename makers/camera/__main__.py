"""`python -m makers.camera [MODULE ...] [--out DIR]`: what the detectors reach on pictures.

Runs every module of this folder that defines `measure()`, a list of Markdown lines (one line that
says so where its data is absent), or only those named, and prints them. With --out the text is also
written to DIR/figures.md, and the modules that define `draw(folder)` draw there.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
from pathlib import Path

from makers import camera


def main() -> None:
    names = sorted(m.name for m in pkgutil.iter_modules(camera.__path__))
    names = [name for name in names if not name.startswith("_")]
    parser = argparse.ArgumentParser(prog="python -m makers.camera", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(names))
    parser.add_argument("--out", type=Path, help="folder for figures.md and the pictures")
    options = parser.parse_args()
    unknown = sorted(set(options.modules) - set(names))
    if unknown:
        parser.error(f"no module {unknown[0]}; there are {', '.join(names)}")
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    text = []
    for name in options.modules or names:
        module = importlib.import_module(f"{camera.__name__}.{name}")
        if not hasattr(module, "measure"):
            continue
        lines = [*module.measure(), ""]
        print("\n".join(lines), flush=True)
        text += lines
        if options.out and hasattr(module, "draw"):
            module.draw(options.out)
    # Some modules only would replace the figures of the others.
    if options.out and not options.modules:
        (options.out / "figures.md").write_text("\n".join(text), encoding="utf-8")


main()
