"""Scores on a road whose lanes begin and end: by the number of lanes, and just behind a change."""

from __future__ import annotations

from typing import Any

import numpy as np

from egolane_pgm.scoring.confusion import confusion
from egolane_pgm.types import UNASSIGNED, BoolArray, IntArray, LaneTruth

#: What counts as just behind a change of lanes, seconds.
BEHIND_S = 10.0


def road_scores(
    assigned: IntArray,
    truth: LaneTruth,
    n_lanes: IntArray,
    changes: IntArray,
    *,
    log_frames: IntArray,
    frame_rate: float,
) -> dict[str, Any]:
    """The scores in scores.json of a road whose lanes change.

    - assigned (K,): the answers in the annotated frames, 1..n or UNASSIGNED.
    - n_lanes (K,): lanes of the road, as the map says.
    - changes (C,): frames of the log in which lanes change.
    - log_frames (K,): which frames of the log are annotated.
    - frame_rate: frames per second.

    Keys: `behind_s`, `changes` (how many), `behind` and `elsewhere` (`frames`, `accuracy`: within
    `behind_s` after a change, and not), `by_lanes` (for each number of lanes `frames`, `accuracy`),
    and `from_right`: the confusion (n + 1 rows of n counts) of lanes counted from the right, 1 the
    rightmost, where answer and truth lie on the map's road.
    """
    scored = ~truth.is_crossing
    right = assigned == truth.lane
    last_change = np.array([-np.inf, *changes])[np.searchsorted(changes, log_frames, side="right")]
    is_behind = log_frames - last_change < BEHIND_S * frame_rate
    most = int(n_lanes.max(initial=1))
    is_on_map = scored & (truth.lane <= n_lanes) & (assigned <= n_lanes)
    answer = np.where(assigned == UNASSIGNED, UNASSIGNED, n_lanes + 1 - assigned)
    from_right = confusion(
        answer[is_on_map], (n_lanes + 1 - truth.lane)[is_on_map], truth.is_crossing[is_on_map], most
    )
    return {
        "behind_s": BEHIND_S,
        "changes": len(changes),
        "behind": _accuracy(right, scored & is_behind),
        "elsewhere": _accuracy(right, scored & ~is_behind),
        "by_lanes": {
            str(n): _accuracy(right, scored & (n_lanes == n)) for n in np.unique(n_lanes).tolist()
        },
        "from_right": from_right.tolist(),
    }


def _accuracy(right: BoolArray, among: BoolArray) -> dict[str, Any]:
    count = int(np.count_nonzero(among))
    return {"frames": count, "accuracy": float(right[among].mean()) if count else None}
