"""Scores of a posterior over lanes; `score_all` computes them all.

Scores read beliefs and ground truth, never the filter. Crossing frames are left out except in the
log-loss.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.confusion import (
    assigned_lane,
    brier,
    expected_calibration_error,
    log_loss_per_frame,
    scores_from_confusion,
)
from egolane_pgm.scoring.events import stability_scores
from egolane_pgm.tools.files import to_jsonable


def score_all(
    belief: ArrayLike,
    truth: pd.DataFrame,
    frame_rate: float,
    assigned: ArrayLike | None = None,
) -> dict[str, Any]:
    """All scores of one drive, ready for JSON; None if a score is undefined.

    - belief: (T, n), rows sum to 1.
    - truth: true_lane and is_crossing of these frames, by frame id.
    - frame_rate: frames per second.
    - assigned: (T,), the answers if they are not the most probable lanes, 1..n or UNASSIGNED.
      Log-loss, Brier score and calibration do not depend on them.

    Keys: `precision`, `recall`, `f1` (means over the lanes), `accuracy`, `coverage`, `per_lane`
    {`precision`, `recall`, `f1`: a list each}, `confusion` (n + 1 rows of n counts),
    `frames_scored` (those not crossing), `frames` (T), `log_loss` (over all frames), `brier`,
    `expected_calibration_error`, `false_switches_per_minute`, `delay` {`median_frames`,
    `p90_frames`, `share_missed`, `changes`}, `intervals` {`accuracy`, `f1`: [low, high], 95 %
    block-bootstrap intervals, None for a short drive}.
    """
    values = np.asarray(belief)
    lane, is_crossing = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
    if assigned is None:
        assigned = assigned_lane(values)
    counts = score_counts(values, lane, is_crossing, assigned)
    intervals = {k: i for k, i in score_intervals([counts]).items() if k in ("accuracy", "f1")}
    losses = log_loss_per_frame(values, lane)
    found = {
        **scores_from_confusion(counts["accuracy"].sum(axis=0)),
        "frames": len(values),
        "log_loss": losses.mean() if len(losses) else None,
        "brier": brier(values, lane, is_crossing),
        "expected_calibration_error": expected_calibration_error(values, lane, is_crossing),
        **stability_scores([(assigned, truth)], frame_rate),
        "intervals": {k: None if i.low is None else [i.low, i.high] for k, i in intervals.items()},
    }
    result: dict[str, Any] = to_jsonable(found)
    return result
