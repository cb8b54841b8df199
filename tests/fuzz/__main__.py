"""`make fuzz`: each reader on files that were damaged at random, and what came of it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.fuzz.trying import ACCEPTED, REFUSED, WRONG, try_readers


def main() -> None:
    """Print a table; the exit status is 1 where anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--times", type=int, default=2000, help="inputs of each reader (2000)")
    parser.add_argument("--only", metavar="READER", action="append", help="only this reader")
    parser.add_argument("--seed", type=int, help="only the input of this seed")
    parser.add_argument("--keep", type=Path, default=Path(".fuzz"), help="folder of wrong ones")
    given = parser.parse_args()
    from tests.fuzz.readers import READERS

    names = [reader.name for reader in READERS]
    for name in given.only or ():
        if name not in names:
            parser.error(f"--only {name}: is not one of {', '.join(names)}")
    seeds = range(given.times) if given.seed is None else range(given.seed, given.seed + 1)
    columns = (REFUSED, ACCEPTED, WRONG)
    print("| reader | tried | refused | accepted | wrong | seconds |")
    print("|---|---:|---:|---:|---:|---:|", flush=True)
    wrong = []
    for tried in try_readers(given.only or names, seeds, given.keep):
        cells = [tried.reader, tried.counts.total(), *(tried.counts[each] for each in columns)]
        print(f"| {' | '.join(map(str, cells))} | {tried.seconds:.0f} |", flush=True)
        wrong += [(tried.reader, seed, what) for seed, what in tried.wrong.items()]
    for reader, seed, what in wrong:
        print(f"wrong: --only {reader!r} --seed {seed}: {what}")
    if wrong:
        sys.exit(f"{len(wrong)} wrong; what was read is in {given.keep}/READER-SEED")


if __name__ == "__main__":
    main()
