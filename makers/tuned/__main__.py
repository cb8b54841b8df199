"""`python -m makers.tuned --out DIR`: what a search of the paper's parameters gives, as tables.md
and tables.png.

One parameter set is searched for each run, for each detector on both roads and for each road with
all detectors, with several seeds. Needs EGOLANE_DATA. The studies are kept in DIR/studies: the same
command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import egolane_pgm as ego
from egolane_pgm.paper import paper_experiment
from egolane_pgm.tools.files import write_text
from makers.tuned import shown
from makers.tuned.measured import measure

HEAD = """
# What a search of the paper's parameters gives, by run, detector and road

Made by `make tuned`: {seeds} seeds, {trials} trials a search, from scratch.
"""

DETECTORS = ("sl", "ml", "sc", "mc", "mld")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.tuned", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and figure")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--trials", type=int, default=1000, help="of each search")
    parser.add_argument("--profile-trials", type=int, default=60, help="for each value")
    options = parser.parse_args()
    tuning = ego.experiments_folder() / "tuning"
    runs = [2, 1, 4, 3, 5]
    files = [paper_experiment(run) for run in (*runs, *(run + 5 for run in runs))]
    files += [tuning / f"detector_{name}.yaml" for name in DETECTORS]
    files += [tuning / f"all_{road}.yaml" for road in ("italy", "spain")]
    work, jobs = options.out / "studies", os.cpu_count() or 1
    numbers = options.seeds, options.trials, options.profile_trials
    groups, drives = measure(files, *numbers, work, jobs)
    head = HEAD.format(seeds=options.seeds, trials=options.trials, profile=options.profile_trials)
    text = "\n\n".join([head.strip(), *shown.page(groups, drives)])
    write_text(options.out / "tables.md", text + "\n")
    shown.draw(groups, drives, options.out / "tables.png")


main()
