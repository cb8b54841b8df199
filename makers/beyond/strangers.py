"""Accuracy on the ten recordings as other detectors might have written them."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import Model, compile_model, make_evidence
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.types import Evidence
from tests.kits.strangers import STRANGERS, Drive, paper_drive

#: The paper's runs.
RUNS = range(1, 11)

#: From the frames so far; with all frames.
FILTERS = (filter_beliefs, smooth_beliefs)

TEXT = """\
# Recordings as other detectors might have written them

Made by `make beyond`, which runs `python -m makers.beyond strangers`. The share of frames
whose lane is right, without labels: the mean over the paper's ten recordings (the worst of them),
then each of runs 1 to 10. Crossing frames are not scored, and Spain (6 to 10) is scored before
frame 9577. `tests/kits/strangers.py` has the changes. The constants are one set
for all, chosen with these ten recordings and these changes in sight. *From the frames so far* is
causal, lane width and flags included; *smoothed* knows all frames, but reads them in the same way.
"""


@functools.cache
def zero_label(n_lanes: int, start_lane: int | None = None) -> Model:
    """The model without labels, which takes everything from the frames so far."""
    start = {} if start_lane is None else {"start_lane": start_lane}
    changes = {"parameters.lane_width_m": "causal", "n_lanes": n_lanes, **start}
    return compile_model(load_experiment("zero_label", changes))


def evidence_of(model: Model, drive: Drive) -> Evidence:
    """The evidence of a drive, without warnings of its oddities."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return make_evidence(model, drive.log)[0]


def accuracies(drives: Sequence[Drive]) -> list[float]:
    """The share of scored frames whose lane is right, with each of FILTERS."""
    right = np.zeros(len(FILTERS))
    n_scored = 0
    for drive in drives:
        model = zero_label(drive.n_lanes)
        evidence = evidence_of(model, drive)
        is_scored = drive.lane > 0
        n_scored += np.count_nonzero(is_scored)
        for k, believe in enumerate(FILTERS):
            lane = assigned_lane(believe(model.compiled, evidence).lane)
            right[k] += np.count_nonzero((lane == drive.lane) & is_scored)
    return list(right / n_scored)


def measure() -> Iterator[str]:
    """The page, a line at a time: mean over the runs and the worst run, then each run."""
    yield TEXT
    yield "| what is done to the recording | from the frames so far | smoothed | each run, causal |"
    yield "|---|---|---|---|"
    for name, change in STRANGERS.items():
        found = np.array([accuracies(change(paper_drive(run))) for run in RUNS])
        cells = [f"{column.mean():.3f} ({column.min():.2f})" for column in found.T]
        each = " ".join(f"{value:.3f}".lstrip("0") for value in found[:, 0])
        yield f"| {name} | {' | '.join(cells)} | {each} |"
