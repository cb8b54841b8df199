"""`python -m makers.tuned --out DIR`: what a search of the paper's parameters gives, as tables.md
and tables.png.

One parameter set is searched for each run, for each detector on both roads and for each road with
all detectors. Needs EGOLANE_DATA. The studies are kept in DIR/studies: the same command goes on
where it stopped.
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

SEEDS, TRIALS, STEPS = 5, 600, 40

#: In the order of the tables: stereo and mono with straight lines, with clothoids, multi-lane.
DETECTORS = {"sl": 2, "ml": 1, "sc": 4, "mc": 3, "mld": 5}

HEAD = f"""# The paper's parameters searched for each run, detector and road

Made by `make tuned`: accuracy over the frames that are not crossing, causal filter; {SEEDS} seeds,
{TRIALS} trials a search, from scratch. *sl, both* is one parameter set for a detector on both
roads, *A4, all* one for all detectors on a road; their recordings count alike. *In-sample*: scored
on the frames that were searched on. *Held out*: five contiguous blocks of a drive, each with what a
search without it found.

![Accuracy, transfer and parameters](tables.png)"""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.tuned", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and figure")
    out = parser.parse_args().out
    tuning, runs = ego.experiments_folder() / "tuning", DETECTORS.values()
    files = [paper_experiment(run) for run in (*runs, *(run + 5 for run in runs))]
    files += [tuning / f"detector_{name}.yaml" for name in DETECTORS]
    files += [tuning / f"all_{road}.yaml" for road in ("italy", "spain")]
    groups, on = measure(files, SEEDS, TRIALS, STEPS, out / "studies", os.cpu_count() or 1)
    write_text(out / "tables.md", "\n\n".join([HEAD, *shown.page(groups, on)]) + "\n")
    shown.draw(groups, on, out / "tables.png")


main()
