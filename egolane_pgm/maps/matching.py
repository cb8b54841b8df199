"""Map matching by a hidden Markov model (Newson and Krumm, 2009, "Hidden Markov map matching
through noise and sparseness").

The states at a time are the segments near its position, and off the map. A position is likelier the
nearer it is to the segment, and the better its heading agrees. A transition between two segments is
likelier the better the length of the way between them along the joins agrees with the distance of
the two positions. Segments are directed.

A pair without such a way (the map is cut, or the receiver jumped) has a small probability, so that
no track is impossible. A position that no car could have reached is an outlier and is ignored,
until several outliers agree with each other.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph, Near, near
from egolane_pgm.maps.positions import Positions
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

OFF = -1


# The constants of the model, chosen by hand.
#: Standard deviation of a position across the road, including the lane's offset, metres.
SIGMA_M = 6.0
#: Scale of the difference between way and straight distance, metres.
BETA_M = 6.0
#: The same as a share of the distance, because curves make long ways longer.
BETA_SHARE = 0.05
#: Standard deviation of the direction of travel, radians.
HEADING_SIGMA = 0.35
#: Largest distance of a segment, metres.
RADIUS_M = 60.0
#: The distance at which off the map is as likely, metres.
OFF_M = 25.0
#: Probability, per position, of leaving the map.
LEAVE = 1e-3
#: Probability, per position, of coming back to the map.
COME = 0.05
#: Probability, per position, of a change to a segment that cannot be reached.
JUMP = 1e-6
#: A position is an outlier above this speed, m/s.
TOP_SPEED_MPS = 80.0

#: Headings are ignored below this speed, m/s.
_MOVES_MPS = 3.0

#: Headings are ignored if two positions are nearer to each other, m.
_MOVES_M = 8.0

#: Probability of a wrong heading.
_HEADING_WRONG = 0.05

#: This many outliers in a row that agree with each other are inliers.
_OUTLIERS_AGREE = 5


def _no_match(positions: Positions) -> dict[str, Any]:
    """The columns of `match` for positions off the map, to be filled in."""
    n = len(positions)
    return {
        "t_s": positions.t_s,
        "segment": np.full(n, OFF),
        "along_m": np.full(n, np.nan),
        "offset_m": np.full(n, np.nan),
        "sure": np.zeros(n),
        "is_outlier": np.zeros(n, dtype=np.bool_),
    }


def match(graph: LaneGraph, positions: Positions, *, online: bool = False) -> pd.DataFrame:
    """The road at each of T positions.

    - online: the most probable segment of the filter, which uses positions up to each one only. By
      default the most probable path of the whole drive (Viterbi), with smoothed probabilities.

    Returns T rows:

    - t_s: seconds.
    - segment: row of the lane graph; OFF off the map, and for outliers.
    - along_m: metres from the segment's start; NaN off the map.
    - offset_m: metres to the right of the way's line; NaN off the map.
    - sure: probability of the segment, or of being off the map; 0 for outliers.
    - is_outlier: marks ignored positions.
    """
    place = graph.plane.metres(positions.latitude, positions.longitude)
    matched = _no_match(positions)
    _find_outliers(positions.t_s, place, matched["is_outlier"])
    used = np.flatnonzero(~matched["is_outlier"])
    found = near(graph, place[used], RADIUS_M)
    emission = _emissions(positions, place, used, found)
    # The states at each time are the near segments and, last, off the map.
    first = found.start + np.arange(len(found.start))
    count = np.diff(first)
    size = np.concatenate([[0], count[:-1] * count[1:]])
    block = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    transition = np.empty(block[-1])
    _fill_transitions(
        found.start, found.segment, found.along_m, place[used], graph.join_start, graph.after,
        graph.length_m, block, transition,
    )  # fmt: skip
    belief = np.empty(len(emission))
    choice = np.empty(len(used), dtype=np.int64)
    filter_states(first, emission, block, transition, belief)
    if online:
        choice[:] = [belief[a:b].argmax() for a, b in pairwise(first)]
    else:
        smooth_states(first, block, transition, belief)
        best_path(first, emission, block, transition, choice)
    on = choice < np.diff(found.start)
    row = found.start[:-1] + choice
    matched["sure"][used] = belief[first[:-1] + choice]
    for name in ("segment", "along_m", "offset_m"):
        matched[name][used[on]] = getattr(found, name)[row[on]]
    return pd.DataFrame(matched)


# --- the model's terms -----------------------------------------------------------------------


@kernel()
def _find_outliers(t_s: FloatArray, place: FloatArray, out: BoolArray) -> None:
    """Fill out (T,): mark positions that cannot be reached from the last inlier, except after
    several in a row that can be reached from each other."""
    last = 0
    agree = 0
    out[:1] = False
    for t in range(1, len(t_s)):
        if _reached(t_s, place, last, t):
            out[t] = False
            agree = 0
            last = t
            continue
        agree = agree + 1 if agree > 0 and _reached(t_s, place, t - 1, t) else 1
        out[t] = agree < _OUTLIERS_AGREE
        if not out[t]:
            agree = 0
            last = t


@kernel()
def _reached(t_s: FloatArray, place: FloatArray, a: int, b: int) -> bool:
    dx = place[b, 0] - place[a, 0]
    dy = place[b, 1] - place[a, 1]
    # Positions of a standing car scatter, too.
    return bool(np.sqrt(dx * dx + dy * dy) <= 20.0 + TOP_SPEED_MPS * (t_s[b] - t_s[a]))


def _emissions(positions: Positions, place: FloatArray, used: IntArray, found: Near) -> FloatArray:
    """Log-likelihood of the states of all times, (N + T,), relative to a place on the way's line:
    of the near segments and, last, of being off the map."""
    given = positions.sigma_m[used]
    sigma = np.fmax(np.hypot(np.where(np.isnan(given), 0.0, given), 4.0), SIGMA_M)
    heading, moved_m = headings(positions, place, used)
    # The heading of the way from the position before is noisier the shorter that way is.
    noise = np.where(np.isnan(moved_m), 0.0, np.sqrt(2) * SIGMA_M / moved_m)
    spread = np.hypot(HEADING_SIGMA, noise)
    count = np.diff(found.start)
    z = found.offset_m / np.repeat(sigma, count)
    turn = (found.heading - np.repeat(heading, count) + np.pi) % (2 * np.pi) - np.pi
    agrees = np.exp(-0.5 * (turn / np.repeat(spread, count)) ** 2)
    direction = np.log((1 - _HEADING_WRONG) * agrees + _HEADING_WRONG)
    on_map = -0.5 * z**2 + np.where(np.isnan(direction), 0.0, direction)
    return np.insert(on_map, found.start[1:], -0.5 * (OFF_M / SIGMA_M) ** 2)


def headings(
    positions: Positions, place: FloatArray, used: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Direction of travel of U used positions, radians counter-clockwise from east, NaN unknown.

    - place (T, 2): metres east and north.

    Without a heading from the receiver it is the direction from the used position before; the
    second array has the metres from there, NaN otherwise.
    """
    step = np.diff(place[used], axis=0, prepend=place[used[:1]])
    far = np.hypot(*step.T)
    given = np.pi / 2 - np.radians(positions.heading_deg[used])
    given = np.where(positions.speed_mps[used] < _MOVES_MPS, np.nan, given)
    moved = np.isnan(given) & (far >= _MOVES_M)
    return np.where(moved, np.arctan2(step[:, 1], step[:, 0]), given), np.where(moved, far, np.nan)


@kernel()
def _fill_transitions(
    start: IntArray,
    segment: IntArray,
    along: FloatArray,
    place: FloatArray,
    join_start: IntArray,
    after: IntArray,
    length: FloatArray,
    block: IntArray,
    transition: FloatArray,
) -> None:
    """Fill transition: log-probabilities from the states of each time to the states of the next,
    row by row; block[t] is the index of the first one from t - 1 to t."""
    leave = np.log(LEAVE)
    come = np.log(COME)
    jump = np.log(JUMP)
    reached_in = np.full(len(length), -1, dtype=np.int64)
    way_to = np.empty(len(length))
    is_done = np.empty(len(length), dtype=np.bool_)
    open_ = np.empty(len(length), dtype=np.int64)
    search = 0
    for t in range(1, len(start) - 1):
        a0 = start[t - 1]
        a1 = start[t]
        b0 = start[t]
        b1 = start[t + 1]
        width = b1 - b0 + 1
        dx = place[t, 0] - place[t - 1, 0]
        dy = place[t, 1] - place[t - 1, 1]
        straight = np.sqrt(dx * dx + dy * dy)
        scale = BETA_M + BETA_SHARE * straight
        limit = straight + 15.0 * scale
        for a in range(a0, a1):
            at = block[t] + (a - a0) * width
            # Distances to the starts of the segments ahead (Dijkstra).
            n_open = 0
            here = segment[a]
            rest = length[here] - along[a]
            if rest <= limit:
                for j in range(join_start[here], join_start[here + 1]):
                    reached_in[after[j]] = search
                    way_to[after[j]] = rest
                    is_done[after[j]] = False
                    open_[n_open] = after[j]
                    n_open += 1
            while n_open > 0:
                k = 0
                for i in range(1, n_open):
                    if way_to[open_[i]] < way_to[open_[k]]:
                        k = i
                s = open_[k]
                n_open -= 1
                open_[k] = open_[n_open]
                is_done[s] = True
                further = way_to[s] + length[s]
                if further > limit:
                    continue
                for j in range(join_start[s], join_start[s + 1]):
                    n = after[j]
                    if reached_in[n] != search:
                        reached_in[n] = search
                        is_done[n] = False
                        way_to[n] = further
                        open_[n_open] = n
                        n_open += 1
                    elif not is_done[n] and further < way_to[n]:
                        way_to[n] = further
            for b in range(b0, b1):
                s = segment[b]
                way = np.inf
                if s == here and along[b] - along[a] > -4.0 * SIGMA_M:
                    way = along[b] - along[a]
                elif reached_in[s] == search:
                    way = way_to[s] + along[b]
                transition[at + b - b0] = max(-abs(way - straight) / scale, jump)
            transition[at + width - 1] = leave
            search += 1
        at = block[t] + (a1 - a0) * width
        for b in range(b0, b1):
            transition[at + b - b0] = come
        transition[at + width - 1] = 0.0


# --- the recursions --------------------------------------------------------------------------
#
# The states of time t are the rows first[t]:first[t + 1] of all M; `emission` (M,) is their
# log-likelihood; the transitions from t - 1 to t begin at block[t].


@kernel()
def filter_states(
    first: IntArray, emission: FloatArray, block: IntArray, transition: FloatArray, out: FloatArray
) -> None:
    """Fill out (M,) with P(state at t | positions up to t)."""
    for t in range(len(first) - 1):
        here = first[t]
        there = first[t + 1]
        weight = np.exp(emission[here:there] - emission[here:there].max())
        if t > 0:
            step = transition[block[t] : block[t + 1]].reshape(-1, there - here)
            weight *= out[first[t - 1] : here] @ np.exp(step)
        out[here:there] = weight / weight.sum()


@kernel()
def smooth_states(
    first: IntArray, block: IntArray, transition: FloatArray, belief: FloatArray
) -> None:
    """Turn the posterior of the filter, (M,), into P(state at t | all positions), in place."""
    for t in range(len(first) - 3, -1, -1):
        here = first[t]
        there = first[t + 1]
        end = first[t + 2]
        step = np.exp(transition[block[t + 1] : block[t + 2]].reshape(-1, end - there))
        predicted = belief[here:there] @ step
        ratio = np.where(predicted > 0.0, belief[there:end] / predicted, 0.0)
        belief[here:there] *= step @ ratio
        belief[here:there] /= belief[here:there].sum()


@kernel()
def best_path(
    first: IntArray, emission: FloatArray, block: IntArray, transition: FloatArray, out: IntArray
) -> None:
    """Fill out (T,) with the states of the most probable path (Viterbi), counted within a time."""
    n_times = len(first) - 1
    score = emission.copy()
    origin = np.zeros(len(emission), dtype=np.int64)
    for t in range(1, n_times):
        before = first[t - 1]
        here = first[t]
        there = first[t + 1]
        step = transition[block[t] : block[t + 1]].reshape(-1, there - here)
        for b in range(there - here):
            ways = score[before:here] + step[:, b]
            origin[here + b] = ways.argmax()
            score[here + b] += ways.max()
    state = np.argmax(score[first[n_times - 1] : first[n_times]])
    for t in range(n_times - 1, -1, -1):
        out[t] = state
        state = origin[first[t] + state]
