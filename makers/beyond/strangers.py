"""Accuracy on the ten recordings as other detectors might have written them."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from egolane_pgm.experiment import experiments_folder, load_experiment
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.model import Model, make_evidence, prepare_model
from egolane_pgm.scoring.assign import assigned_lane
from tests.kits.strangers import STRANGERS, Drive, paper_drive

#: From the frames so far; with all frames.
FILTERS = ("exact", "smoothed")

TEXT = """\
# Recordings as other detectors might have written them

Made by `make beyond`, which runs `python -m makers.beyond strangers`. The share of frames
whose lane is right, without labels: the mean over the paper's ten recordings (the worst of them),
then each of runs 1 to 10. Crossing frames are not scored, and Spain (6 to 10) is scored before
frame 9577. `tests/kits/strangers.py` says what is done to a recording. The constants are one set
for all, chosen with these ten recordings and these changes in sight. *From the frames so far* is
causal, lane width and flags included; *smoothed* knows all frames, but reads them in the same way.
"""


@functools.cache
def zero_label(n_lanes: int, overrides: tuple[str, ...] = ()) -> Model:
    """The model without labels, which takes all from the frames so far."""
    causal = ("parameters.lane_width_m=causal", f"n_lanes={n_lanes}")
    given = load_experiment(experiments_folder() / "zero_label.yaml", (*causal, *overrides))
    return prepare_model(given)


def accuracies(drives: Sequence[Drive], overrides: tuple[str, ...] = ()) -> list[float]:
    """The share of scored frames whose lane is right, of each of FILTERS."""
    right = np.zeros(len(FILTERS))
    n_scored = 0
    for drive in drives:
        model = zero_label(drive.n_lanes, overrides)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            evidence = make_evidence(model, drive.log).filtered
        is_scored = drive.lane > 0
        n_scored += np.count_nonzero(is_scored)
        for k, name in enumerate(FILTERS):
            lane = assigned_lane(infer_beliefs(model.compiled, evidence, name).lane)
            right[k] += np.count_nonzero((lane == drive.lane) & is_scored)
    return list(right / n_scored)


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """The page, a line at a time: mean over the runs and the worst run, then each run."""
    yield TEXT
    yield "| what is done to the recording | from the frames so far | smoothed | each run, causal |"
    yield "|---|---|---|---|"
    for name, change in STRANGERS.items():
        if only not in name:
            continue
        found = np.array([accuracies(change(paper_drive(r)), tuple(overrides)) for r in runs])
        cells = [f"{column.mean():.3f} ({column.min():.2f})" for column in found.T]
        each = " ".join(f"{value:.3f}".lstrip("0") for value in found[:, 0])
        yield f"| {name} | {' | '.join(cells)} | {each} |"
