"""Drives that nobody looked at: other seeds and other donors than the benchmark's tracks have."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from egolane_pgm.experiment import Experiment, experiments_folder, load_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.events import score_events
from egolane_pgm.tools.jobs import in_order
from egolane_pgm.types import FloatArray
from makers.benchmark import tracks as making
from makers.benchmark.board import run_on, score_recording
from makers.benchmark.tracks import Recording, rng_of
from makers.benchmark.transplanting import RATE, transplanted
from makers.benchmark.transplanting import Path as Driven

#: Donors of each stretch of the trip, and the length of the other drives, frames.
_DONORS, _FRAMES = 4, 1800

#: How much of the beginning of a drive is scored apart, seconds.
_BEGINNING_S = 60.0

#: The mean of the seconds between two drawn lane changes, beyond the least.
_MEAN_S, _LEAST_S = 25.0, 6.0

TEXT = """\
# Drives that nobody looked at

Made by `python -m makers.beyond drawn`: lines of the paper's ten recordings, transplanted as for
the benchmark's tracks, with other seeds. *Rotterdam*: each annotated stretch with four donors.
*Drawn*: three minutes of each donor on roads of 3, 4 and 5 lanes, a lane change every 31 s in the
mean, at least 6 s apart. Means over drives of the share of frames whose lane is right; *sure* is a
belief over .95. First causal, then smoothed; *MLD* are the two multi-lane donors, with precision
and recall of their lane changes (from and to the true lanes or to the true side, within 2 s; all
drives of a row together). These drives were made after the constants were chosen, but their donors
are the recordings that they were chosen on.

| track | drives | right | first minute | sure | right where sure | right, MLD | changes, MLD \
| smoothed: right | sure | right where sure |
|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"""


def rotterdam() -> Iterator[Recording]:
    """The stretches of the benchmark's trip with four donors each."""
    for k, (begin, end, n_lanes, changes) in enumerate(making.stretches_of(making.ANNOTATIONS)):
        at = [(when - begin, before, after) for when, before, after in changes]
        for run in ((3 * k + j) % len(making.DONORS) + 1 for j in range(_DONORS)):
            name = f"trip1-{int(begin)}-n{n_lanes}-{making.DONORS[run][0]}-new"
            path = making.driven(at, round(RATE * (end - begin)), n_lanes, rng_of(name, "path"))
            yield _recording("Rotterdam", name, path, run)


def drawn() -> Iterator[Recording]:
    """Each donor on roads of 3, 4 and 5 lanes, with lane changes at random."""
    for run in making.DONORS:
        for n_lanes in (3, 4, 5):
            name = f"drawn-n{n_lanes}-{making.DONORS[run][0]}"
            rng = rng_of(name, "path")
            lane, when, changes = int(rng.integers(1, n_lanes + 1)), 0.0, []
            while (when := when + _LEAST_S + rng.exponential(_MEAN_S)) < _FRAMES / RATE:
                sides = [side for side in (-1, 1) if 1 <= lane + side <= n_lanes]
                changes.append((when, lane, lane + int(rng.choice(sides))))
                lane = changes[-1][2]
            path = making.driven(changes or [(0.0, lane, lane)], _FRAMES, n_lanes, rng)
            yield _recording("drawn", name, path, run)


def _recording(track: str, name: str, path: Driven, run: int) -> Recording:
    log, donor = transplanted(making.donor(run), path, rng_of(name, "lines")), making.DONORS[run][0]
    n_lanes = path.n_lanes
    title = f"{track}, {n_lanes} lanes"
    return Recording(title, name, name, name, donor, n_lanes, log, path.truth())


def scores(experiment: Experiment, recording: Recording) -> dict[str, float]:
    """Shares of the frames of a drive; NaN of none."""
    result, truth = run_on(recording, experiment), recording.truth
    belief, time_s = result.marginals["Lane"], recording.log.time_s
    sums = score_recording(recording, belief)
    events = score_events(result.events, truth, RATE)
    within = events["within"]["2"]
    right = assigned_lane(belief) == truth.lane
    first = ~truth.is_crossing & (time_s - time_s[0] < _BEGINNING_S)
    with np.errstate(invalid="ignore"):
        return {
            "right": sums["right"] / sums["scored"],
            "first": float(np.divide((right & first).sum(), first.sum())),
            "sure": sums["sure"] / sums["scored"],
            "n_sure": sums["sure"],
            "sure_right": sums["sure_right"],
            "is_mld": float(recording.donor.endswith("mld")),
            "changes": events["changes"],
            "changes_told": within["right"] + within["false"],
            "changes_right": within["right"],
        }


def rows(recordings: Sequence[Recording], overrides: Sequence[str]) -> Iterator[str]:
    """A row of the table for each track."""
    tracks = defaultdict(list)
    for each in recordings:
        tracks[each.track].append(each)
    for track, drives in sorted(tracks.items()):
        cells = [track, str(len(drives))]
        for filter_ in ("exact", "smoothed"):
            keys = (f"filter={filter_}", *overrides)
            experiment = load_experiment(experiments_folder() / "zero_label.yaml", keys)
            found = list(in_order(partial(scores, experiment), drives, 1))
            of = {key: np.array([each[key] for each in found]) for key in found[0]}
            keys_shown = ("right", "first", "sure") if filter_ == "exact" else ("right", "sure")
            cells += [_share(np.nanmean(of[key])) for key in keys_shown]
            cells.append(_share(of["sure_right"].sum() / of["n_sure"].sum()))
            if filter_ == "exact":
                cells += _cells_of_mld(of)
        yield f"| {' | '.join(cells)} |"


def _cells_of_mld(of: Mapping[str, FloatArray]) -> list[str]:
    """Of the drives with the lines of a multi-lane detector: the share of right frames, precision
    and recall of lane changes; empty where there are none."""
    is_mld = of["is_mld"] > 0
    if not is_mld.any():
        return ["", ""]
    hits = of["changes_right"][is_mld].sum()
    both = [hits / of[key][is_mld].sum() for key in ("changes_told", "changes")]
    return [_share(of["right"][is_mld].mean()), " / ".join(map(_share, both))]


def _share(value: float) -> str:
    return f"{value:.3f}"


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """The page, a line at a time."""
    yield TEXT
    yield from rows([each for each in (*rotterdam(), *drawn()) if only in each.name], overrides)
