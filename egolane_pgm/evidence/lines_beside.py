"""How well the lines that are seen fit roads of different numbers of lanes.

Counting votes for lanes of a road whose number of lanes is given; it says nothing of that number.
Here the lines are counted from the car to both sides. In lane i of a road of n lanes there are i
lines to the left and n + 1 - i to the right, the outermost ones are mostly continuous, and beyond
them there are none. A number of lanes fits as well as the best of its lanes.

Where the number is a guess, `off_by` follows by such fits whether there is a lane less or more.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: P(the line is seen) for the first, second and third line to either side of the car, if it is
#: there; and if it is not (clutter, a shoulder's edge).
SEEN = (0.85, 0.75, 0.4)
SEEN_NOTHING = 0.08

#: P(it is flagged as continuous) of the left edge, an inner line, the right edge and a false line.
FLAGGED = {"left": 0.75, "inner": 0.03, "right": 0.4, "nothing": 0.05}

#: The weight of a frame. Detectors hold a line, miss it or shift it for seconds, so that frames of
#: about one second, at ten a second, say the same. It was chosen on eight simulated drives, from
#: .02 to .3.
WEIGHT = 0.1


def fit_of_counts(log: LineLog, most: int, lane_width_m: float) -> FloatArray:
    """How well each number of lanes fits each frame: (T, most), column n - 1 that of n lanes; the
    best of a frame is 1.

    - lane_width_m: in the detector's metres.
    """
    reach = len(SEEN)
    bins = np.floor(np.where(log.is_valid, log.offset_m, np.inf) / lane_width_m)
    # A detector that never flags a line cannot tell.
    tells = bool(log.is_continuous.any())
    fit = np.full((len(log), most), -np.inf)
    seen = np.zeros((len(log), 2 * reach), dtype=bool)
    flagged = np.zeros_like(seen)
    for k in range(2 * reach):
        is_it = bins == k - reach
        seen[:, k] = is_it.any(axis=1)
        flagged[:, k] = (is_it & log.is_continuous).any(axis=1)
    for n in range(1, most + 1):
        for lane in range(1, n + 1):
            score = np.zeros(len(log))
            for k in range(2 * reach):
                # The k-th line from the left within reach; its number on the road, from 0.
                line = lane + k - reach
                kind = (
                    "left"
                    if line == 0
                    else "right"
                    if line == n
                    else "inner"
                    if 0 < line < n
                    else "nothing"
                )
                away = reach - 1 - k if k < reach else k - reach
                p = SEEN_NOTHING if kind == "nothing" else SEEN[away]
                flag = FLAGGED[kind] if tells else 0.5
                score += np.where(
                    seen[:, k],
                    np.log(p) + np.where(flagged[:, k], np.log(flag), np.log(1 - flag)),
                    np.log(1 - p),
                )
            fit[:, n - 1] = np.maximum(fit[:, n - 1], score)
    fit -= fit.max(axis=1, keepdims=True)
    return np.asarray(np.exp(WEIGHT * fit))


def own_lane_m(log: LineLog) -> FloatArray:
    """(T,): metres between the nearest valid lines left and right of the car; infinite where one of
    them is not seen."""
    offset = np.where(log.is_valid, log.offset_m, np.nan)
    left = np.where(offset < 0, -offset, np.inf).min(axis=1, initial=np.inf)
    right = np.where(offset > 0, offset, np.inf).min(axis=1, initial=np.inf)
    return np.asarray(left + right)


def tells_the_number(log: LineLog, lane_width_m: float) -> BoolArray:
    """(T,): whether a line is seen beyond those of the car's own lane."""
    is_beyond = log.is_valid & (np.abs(log.offset_m) > lane_width_m)
    return np.asarray(is_beyond.any(axis=1) & ~log.is_missing)


def off_by(fit: FloatArray, goes_on: BoolArray, wrong: float, stays: float) -> IntArray:
    """Whether there seem to be as many lanes as a guess says (0), or one less (-1) or more (1):
    what is most probable given the lines so far, (T,); 0 where there is no guess and where one
    begins.

    - fit: (T, 3) of a lane less, the guess and a lane more; 0 for a road that cannot be
    - goes_on: (T,) whether the number is a guess, as in the frame before
    - wrong, stays: P(one less or more), and P(that stays) from frame to frame
    """
    off = np.zeros(len(fit), dtype=np.int64)
    belief = prior = np.array([wrong / 2, 1 - wrong, wrong / 2])
    for t in range(len(fit)):
        if not goes_on[t]:
            belief = prior
            continue
        belief = (stays * belief + (1 - stays) * prior) * fit[t]
        belief /= belief.sum()
        off[t] = belief.argmax() - 1 if belief.max() > belief[1] else 0
    return off
