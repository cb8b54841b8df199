"""Scores of a posterior over lanes; `score_all` computes them all.

Scores read beliefs and ground truth, never the filter. Crossing frames are left out except in the
log-loss.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from egolane_pgm.scoring.bootstrap import score_intervals
from egolane_pgm.scoring.confusion import assigned_lane, confusion, scores_from_confusion
from egolane_pgm.scoring.events import stability_scores
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.tools.files import to_jsonable

#: The scores with an interval in every result. Those of the others are made by `compare`.
INTERVALS = ("accuracy", "f1")

#: The scores that do not depend on the answers.
OF_BELIEF = ("log_loss", "brier", "expected_calibration_error")


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
    lane = truth["true_lane"].to_numpy()
    is_crossing = truth["is_crossing"].to_numpy()
    given = assigned_lane(values) if assigned is None else np.asarray(assigned)
    answers = Answers(values, lane, is_crossing, given)
    intervals = score_intervals([{name: SCORES[name].summands(answers) for name in INTERVALS}])
    found = {
        **scores_from_confusion(confusion(given, lane, is_crossing, values.shape[1])),
        "frames": len(values),
        **{name: SCORES[name].of(answers) for name in OF_BELIEF},
        **stability_scores([(given, truth)], frame_rate),
        "intervals": {k: None if i.low is None else [i.low, i.high] for k, i in intervals.items()},
    }
    result: dict[str, Any] = to_jsonable(found)
    return result
