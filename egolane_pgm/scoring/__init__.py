"""How right a belief over lanes is: one file per family of scores; `score_all` gives them all.

Scores read beliefs and ground truth, never the filter. Crossing frames are left out except where a
score says otherwise (log-loss).
"""

# `confusion.confusion` is not exported: its name would hide the module's.
from egolane_pgm.scoring.confusion import (
    ConfusionScores,
    assigned_lane,
    frames_off,
    scores_from_confusion,
)
from egolane_pgm.scoring.summary import score_all

__all__ = ["ConfusionScores", "assigned_lane", "frames_off", "score_all", "scores_from_confusion"]
