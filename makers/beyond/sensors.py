"""Scores of the model without labels with poorer sensors, and over starts of the drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from egolane_pgm.inference.events import SURE, lane_events
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.scoring.events import Reported, score_events
from egolane_pgm.types import LineLog, lane_truth
from makers.beyond.strangers import RUNS, evidence_of, zero_label
from tests.kits.strangers import (
    STRANGERS,
    Change,
    Drive,
    nearest,
    never_continuous,
    paper_drive,
    without,
)

#: First frames of a drive, at ten frames a second.
STARTS = (0, 100, 200, 300, 400, 500, 600)

TEXT = """\
# What a sensor must give

Made by `make beyond`, which runs `python -m makers.beyond sensors`. The model without labels
(`zero_label.yaml`, causal) on the paper's ten recordings, cut down to what a lesser sensor gives.
Non-crossing frames; Spain before frame 9577. *Right*: mean over the ten recordings (the worst).
*Sure*: share of the frames with a belief of .95 or more, and how many of these are right.
*Changes*: precision and recall within 2 s; without a lane their direction counts. The constants
were chosen with these recordings in sight: development scores.

| what the sensor gives | right (worst) | sure | right where sure | changes, precision / recall |
|---|--:|--:|--:|--:|"""

STARTS_TEXT = """
## Where one starts to read

The same model on each recording as it is, read from frame 0, 100, ..., 600 on: lowest, mean and
highest share of right frames. It is the first minute that differs. *Sure* and *right where sure*
are of the whole recording, read from frame 0.

| run | lowest | mean | highest | sure | right where sure |
|---|--:|--:|--:|--:|--:|"""


def own_lines(log: LineLog) -> LineLog:
    """Only the valid line nearest to the vehicle on either side."""
    keep = np.zeros(log.offset_m.shape, dtype=bool)
    for side in (-1, 1):
        is_there = log.is_valid & (np.sign(log.offset_m) == side)
        away = np.where(is_there, np.abs(log.offset_m), np.inf)
        rows = np.flatnonzero(np.isfinite(away.min(axis=1)))
        keep[rows, away[rows].argmin(axis=1)] = True
    return without(log, ~keep)


def _lines(change: Callable[[LineLog], LineLog]) -> Change:
    """A change of the lines only."""
    return lambda drive: [replace(drive, log=change(drive.log))]


def plain_own_lines(log: LineLog) -> LineLog:
    """The own lines, never continuous."""
    return never_continuous(own_lines(log))


#: Changes of a recording, and whether the start lane is given.
SENSORS: dict[str, tuple[Change, bool]] = {
    "all lines, as recorded": (STRANGERS["as recorded"], False),
    "all lines, no type": (STRANGERS["no line continuous"], False),
    "the four nearest lines": (_lines(lambda log: nearest(log, 4)), False),
    "the own two lines, with their type": (_lines(own_lines), False),
    "the own two lines, no type": (_lines(plain_own_lines), False),
    "the own two lines, no type, start lane given": (_lines(plain_own_lines), True),
    "60 % of all lines missing": (STRANGERS["60 % of lines missing"], False),
    "no line for 2 s, 30 % of the time": (STRANGERS["blind for 2 s, 30 % of the time"], False),
    "2 frames a second": (STRANGERS["every 5th, renumbered, rate said"], False),
    "30 frames a second": (STRANGERS["30 frames a second"], False),
}


def scores(drive: Drive, start: int | None = None) -> list[float]:
    """Numbers of frames and lane changes of a drive.

    - start: the lane of the first frame, if it is given.

    Returns the frames that are scored, right, sure, and both; the changes that are detected, false
    and missed.
    """
    model = zero_label(drive.n_lanes, start)
    evidence = evidence_of(model, drive)
    beliefs = filter_beliefs(model.compiled, evidence, "exact", frame_id=drive.log.frame_id)
    is_scored, sure = drive.lane > 0, beliefs.lane.max(axis=1) >= SURE
    is_right = (assigned_lane(beliefs.lane) == drive.lane) & is_scored
    rate = 1 / float(np.median(np.diff(drive.log.time_s)))
    events = lane_events(beliefs, rate, time_s=drive.log.time_s)
    # Frames that are not scored lie in crossings, but for those after the last one.
    rows = np.arange(np.flatnonzero(is_scored)[0], np.flatnonzero(is_scored)[-1] + 1)
    before = np.maximum.accumulate(np.where(is_scored, np.arange(len(is_scored)), 0))
    truth = lane_truth(drive.log.frame_id[rows], drive.lane[before[rows]], ~is_scored[rows])
    within = score_events([Reported(events, truth)], rate)["within"]["2"]
    return [
        *(float(np.count_nonzero(each)) for each in (is_scored, is_right)),
        *(float(np.count_nonzero(each)) for each in (sure & is_scored, sure & is_right)),
        *(float(within[key]) for key in ("right", "false", "missed")),
    ]


def measure() -> Iterator[str]:
    """The page, a line at a time."""
    yield TEXT
    for name, (change, is_told) in SENSORS.items():
        found = []
        for run in RUNS:
            drives = change(paper_drive(run))
            starts = [int(each.lane[each.lane > 0][0]) if is_told else None for each in drives]
            each = zip(drives, starts, strict=True)
            found.append(np.sum([scores(d, s) for d, s in each], axis=0))
        n, right, sure, both, hits, false, missed = np.array(found).T
        n_hits = hits.sum()
        cells = [
            f"{(right / n).mean():.3f} ({(right / n).min():.2f})",
            f"{(sure / n).mean():.2f}",
            f"{both.sum() / max(sure.sum(), 1):.4f}",
            f"{n_hits / max((hits + false).sum(), 1):.3f} / {n_hits / (hits + missed).sum():.3f}",
        ]
        yield f"| {name} | {' | '.join(cells)} |"
    yield STARTS_TEXT
    shares = []
    for run in RUNS:
        drive = paper_drive(run)
        found = []
        for start in STARTS:
            later = replace(drive, log=drive.log.take(slice(start, None)), lane=drive.lane[start:])
            found.append(scores(later)[:4])
        n, right, sure, both = np.array(found).T
        share = right / n
        shares.append(share)
        values = (share.min(), share.mean(), share.max(), sure[0] / n[0], both[0] / sure[0])
        cells = [f"{value:.4f}" for value in values]
        yield f"| {run} | {' | '.join(cells)} |"
    mean = np.mean(shares, axis=0)
    cells = [f"{value:.4f}" for value in (mean.min(), mean.mean(), mean.max())]
    yield f"| mean of these | {' | '.join(cells)} | | |"
