"""`python -m makers.benchmark --out DIR`: the public board, as README.md and pictures.

The tracks paper and rotterdam are made from the paper's recordings; motion and two_lines are those
in EGOLANE_DATA/bench, where there is such a folder. The scores are kept in results/runs/benchmark.
"""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import egolane_pgm as ego
from egolane_pgm.benchmark.board import read_board
from egolane_pgm.benchmark.making import make_tracks
from egolane_pgm.benchmark.scored import Entry, score_entry
from egolane_pgm.benchmark.tracks import Recording, read_tracks
from egolane_pgm.experiment import load_experiment
from egolane_pgm.tools.files import write_json, write_text
from egolane_pgm.tools.jobs import in_order
from egolane_pgm.verbs.benchmark import entry_of
from makers.benchmark import page
from makers.benchmark.fitting import learned, searched

WORK = Path("results/runs/benchmark")

#: Recordings of each entry on which causality is checked.
CHECKED = 2

FOLDER = ego.experiments_folder() / "benchmark"
SEARCHED, LEARNED = FOLDER / "graph_searched.yaml", FOLDER / "graph_learned.yaml"
STICKY = FOLDER / "sticky.yaml"

#: What is scored as it stands: an experiment or a file, and what is changed in it.
PLAIN = {
    page.POSITION: ("zero_label", {}),
    page.NO_SIGHT: ("zero_label", {"parameters.sight": "generic"}),
    page.NO_WIDTH: ("zero_label", {"parameters.lane_width_m": 3.5}),
    page.NO_MOTION: ("zero_label", {"parameters.motion_gain": 0}),
    page.NO_FLAGS: ("zero_label", {"evidence": str(FOLDER / "no_flags.py")}),
    page.AFTER_1_S: ("zero_label", {"filter": "fixed_lag", "lag": 10}),
    page.AFTER_3_S: ("zero_label", {"filter": "fixed_lag", "lag": 30}),
    page.SMOOTHED: ("zero_label", {"filter": "smoothed"}),
    page.PUBLISHED: (ego.experiments_folder() / "paper/run01_italy_ml.yaml", {}),
    page.STICKY: (STICKY, {}),
    page.RULE: (FOLDER / "rule.yaml", {}),
    page.COUNTING: (FOLDER / "counting.yaml", {}),
    page.BOOSTING: (FOLDER / "boosting.py", {}),
}

#: What is fitted to the drives of other drivers.
FITTED: dict[str, tuple[Callable[..., object], Path, dict[str, object]]] = {
    page.SEARCHED: (searched, SEARCHED, {}),
    page.LEARNED: (learned, LEARNED, {}),
    page.AUTOREGRESSIVE: (searched, SEARCHED, {"graph": "autoregressive"}),
    page.WOR_ON_LANE: (learned, LEARNED, {"graph": "wor_on_lane"}),
    page.STICKY_SEARCHED: (searched, STICKY, {}),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m makers.benchmark", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the page")
    parser.add_argument("--every", type=int, default=1, help="every Nth recording only, to try")
    parser.add_argument("--page-only", action="store_true", help="from the scores that are there")
    options = parser.parse_args()
    if not options.page_only:
        places, said = tracks()
        print("\n".join(said), flush=True)
        score_all(places, options.every)
    files = sorted((WORK / "scores").glob("*.json"))
    board = read_board(files)
    board.draw(options.out, page.DRAWN)
    write_text(options.out / "README.md", page.text(board, options.every))


def tracks() -> tuple[list[Path], list[str]]:
    """The folders of the tracks, made anew, and what was made."""
    made = WORK / "tracks"
    shutil.rmtree(made, ignore_errors=True)
    said = make_tracks(made, None)
    bench = Path(os.environ.get("EGOLANE_DATA", "")) / "bench"
    own = [bench / name for name in ("motion", "two_lines") if (bench / name).is_dir()]
    return [*own, made / "rotterdam", made / "paper"], said


def score_all(places: Sequence[Path], every: int) -> None:
    scores = WORK / "scores"
    shutil.rmtree(scores, ignore_errors=True)
    scores.mkdir(parents=True)
    recordings = read_tracks(places)[::every]
    # The longest first: a process scores one entry after the other.
    titles = [*FITTED, *PLAIN]
    for number, found in enumerate(in_order(partial(_scored, recordings), titles, 2)):
        write_json(scores / f"{number:02d}.json", found)
        print(titles[number], found["check"], flush=True)


def _scored(recordings: Sequence[Recording], title: str) -> dict[str, object]:
    return score_entry(_entry(title), recordings, checked=CHECKED)


def _entry(title: str) -> Entry:
    if title in FITTED:
        fit, file, changes = FITTED[title]
        return Entry(title, None, partial(fit, load_experiment(file, changes)))
    given, changes = PLAIN[title]
    return entry_of(str(given), title, changes)


main()
