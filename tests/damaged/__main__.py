"""`make fuzz`: each reader on files that were damaged at random, and what came of it."""

from __future__ import annotations

import argparse
import shutil
import sys
import warnings
from pathlib import Path

from tests.damaged.readers import READERS
from tests.damaged.trying import whole_files, wrong_with_seeds


def main() -> None:
    """Print what is wrong; then the exit status is 1."""
    parser = argparse.ArgumentParser(prog="python -m tests.damaged", description=__doc__)
    parser.add_argument("--times", type=int, default=300, help="inputs of each reader (300)")
    parser.add_argument("--only", choices=READERS, action="append", help="only this reader")
    parser.add_argument("--seed", type=int, help="only the input of this seed")
    parser.add_argument("--keep", type=Path, default=Path(".fuzz"), help="folder of what is tried")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(given.times) if given.seed is None else [given.seed]
    n_wrong = 0
    for name in given.only or READERS:
        folder = given.keep.absolute() / name.replace(" ", "_")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        wrong = wrong_with_seeds(name, folder, whole_files(name, folder), seeds)
        print(f"{name}: {len(wrong)} of {len(seeds)} wrong", *wrong, sep="\n  ", flush=True)
        n_wrong += len(wrong)
    if n_wrong:
        sys.exit(f"{n_wrong} wrong; what was read is in {given.keep}/READER/wrong-SEED")


if __name__ == "__main__":
    main()
