"""The public board: the scores of entries on each track.

An entry is an experiment, or a folder with beliefs NAME.csv for each NAME.csv of the tracks
(`frame_id;p1;p2;...`, a row per frame, none if the entry is silent). Every score of a track is a
ratio of sums over its recordings, so drives can be resampled.
"""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

import egolane_pgm as ego
from egolane_pgm.inference.events import SURE
from egolane_pgm.scoring.bootstrap import RESAMPLES
from egolane_pgm.scoring.confusion import (
    assigned_lane,
    confusion,
    log_loss_per_frame,
    scores_from_confusion,
)
from egolane_pgm.tools.files import temporary_folder, write_text
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.views.tables import Table, page, with_interval
from makers.benchmark.tracks import HERE, Recording, make_tracks, read_tracks

#: The page after this line is rewritten.
MARK = "<!-- the board -->\n"

#: Each score: the sum above and the sum below.
SCORES = {
    "accuracy": ("recalls", "lanes_driven"),
    "log-loss": ("losses", "frames"),
    "sure": ("sure", "scored"),
    "right if sure": ("sure_right", "sure"),
}


def score_entry(recordings: Sequence[Recording], entry: Path) -> tuple[str, pd.DataFrame]:
    """The title of an entry, and its sums on each recording, a row each."""
    if entry.is_dir():
        title, beliefs = entry.name, [read_beliefs(entry, each) for each in recordings]
    else:
        experiment = ego.load_experiment(entry)
        title, results = experiment.description, [run_on(each, experiment) for each in recordings]
        beliefs = [result.node("Lane") for result in results]
    return title, pd.DataFrame(map(score_recording, recordings, beliefs))


def run_on(recording: Recording, experiment: ego.Experiment) -> ego.Result:
    """The result of an experiment that is given the lines and the number of lanes."""
    lines, n_lanes = recording.log, recording.n_lanes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return ego.run(lines, experiment=experiment, n_lanes=n_lanes)


def read_beliefs(folder: Path, recording: Recording) -> FloatArray:
    """(T, n): the beliefs of a file, zeros in silent frames. Raises InputError for other columns,
    frames that the recording does not have, and rows that do not sum to 1 (or 0: silent)."""
    file, frames = folder / f"{recording.name}.csv", recording.log.frame_id
    table = pd.read_csv(file, sep=";", index_col="frame_id", dtype=float)
    sums = table.sum(axis=1)
    fits = (
        table.index.isin(frames) & ((abs(sums - 1) < 1e-3) | (sums == 0)) & (table.min(axis=1) >= 0)
    )
    if table.shape[1] != recording.n_lanes or not fits.all():
        raise InputError(
            f"{file}: needs p1 to p{recording.n_lanes}, known frames, sums of 1 (or 0)"
        )
    belief = table.div(sums.where(sums > 0, 1), axis=0)
    return belief.reindex(frames, fill_value=0.0).to_numpy()


def score_recording(recording: Recording, belief: FloatArray) -> dict[str, float]:
    """The sums of SCORES, of beliefs (T, n). Ties and silence are wrong."""
    lane = recording.truth["true_lane"].to_numpy()
    is_crossing = recording.truth["is_crossing"].to_numpy()
    assigned = assigned_lane(belief)
    matrix = confusion(assigned, lane, is_crossing, recording.n_lanes)
    is_driven = matrix.sum(axis=0) > 0
    scored = ~is_crossing
    right = (assigned == lane) & scored
    sure = (belief.max(axis=1) >= SURE) & scored
    return {
        "recalls": scores_from_confusion(matrix)["per_lane"]["recall"][is_driven].sum(),
        "lanes_driven": is_driven.sum(),
        "losses": log_loss_per_frame(belief, lane).sum(),
        "frames": len(lane),
        "right": right.sum(),
        "sure": sure.sum(),
        "sure_right": (sure & right).sum(),
        "scored": scored.sum(),
    }


def resamples(recordings: Sequence[Recording]) -> FloatArray:
    """(1 + R, D): all D recordings, then how often each is drawn in R resamples: drivers first,
    then drives of each of them, with all recordings of a drive."""
    rng = np.random.default_rng(0)
    tree: dict[str, dict[str, list[int]]] = {}
    for k, each in enumerate(recordings):
        tree.setdefault(each.driver, {}).setdefault(each.drive, []).append(k)
    drivers = [list(drives.values()) for drives in tree.values()]
    weights = np.zeros((1 + RESAMPLES, len(recordings)))
    weights[0] = 1
    for row in weights[1:]:
        for k in rng.integers(0, len(drivers), len(drivers)):
            for drive in rng.integers(0, len(drivers[k]), len(drivers[k])):
                row[drivers[k][drive]] += 1
    return weights


def total(sums: pd.DataFrame, score: str, weights: FloatArray) -> FloatArray:
    """(R,): a score of D recordings, weighted by each row of `weights` (R, D)."""
    above, below = (weights @ sums[key].to_numpy(float) for key in SCORES[score])
    return np.divide(above, below, out=np.full(len(above), np.nan), where=below > 0)


def main() -> None:
    """Make the tracks (`--make DIR [--uah COPY]`), or the board of the experiments in entries/ and
    of FOLDERs, on the tracks paper and rotterdam, and those in EGOLANE_DATA/bench."""
    parser = argparse.ArgumentParser(prog="python -m makers.benchmark")
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=Path("results/benchmark/README.md"))
    parser.add_argument("--make", type=Path, metavar="DIR")
    parser.add_argument("--uah", type=Path, metavar="COPY")
    options = parser.parse_args()
    if options.make:
        return make_tracks(options.make, options.uah)
    bench = Path(os.environ.get("EGOLANE_DATA", "")) / "bench"
    with temporary_folder() as made:
        make_tracks(made)
        folders = [bench / "motion", bench / "two_lines", made / "rotterdam", made / "paper"]
        recordings = read_tracks(folders)
    entries = [*sorted(HERE.glob("entries/*.yaml")), *options.folders]
    scored = dict(parallel(partial(score_entry, recordings), entries, jobs=2))
    head = options.out.read_text().partition(MARK)[0]
    write_text(options.out, head + MARK + "\n" + board(recordings, scored))


def board(recordings: Sequence[Recording], scored: Mapping[str, pd.DataFrame]) -> str:
    """The tables of all entries' sums: accuracy on each track, differences, the other scores."""
    accuracy, gap = {title: [title] for title in scored}, {title: [title] for title in scored}
    tracks, others = sorted({each.track for each in recordings}), [*SCORES][1:]
    parts: list[str | Table] = []
    for track in tracks:
        here = [k for k, each in enumerate(recordings) if each.track == track]
        on = {title: sums.iloc[here] for title, sums in scored.items()}
        weights = resamples([recordings[k] for k in here])
        drawn = {title: total(sums, "accuracy", weights) for title, sums in on.items()}
        first = next(iter(drawn.values()))
        for title, values in drawn.items():
            for cells, each, form in ((accuracy, values, ".3f"), (gap, first - values, "+.3f")):
                bounds = np.quantile(each[1:], (0.025, 0.975)).tolist()
                cells[title].append(with_interval(each[0], bounds, form))
        rows = []
        for title, sums in on.items():
            values = (total(sums, score, weights[:1])[0] for score in others)
            rows.append([title, *(f"{each:.3f}".replace("nan", "-") for each in values)])
        if track in ("motion, 3 lanes", "rotterdam", "two_lines"):
            parts += [f"### {track}", Table(["entry", *others], rows)]
    header = ["entry", *tracks]
    tables = [Table(header, [*accuracy.values()]), "The first entry less each other one, paired:"]
    return page([*tables, Table(header, [*gap.values()][1:]), *parts], style="wide") + "\n"
