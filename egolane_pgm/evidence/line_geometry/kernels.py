"""The numba kernels of `line_geometry`.

Constants of other files are arguments: numba's cache notices changes of this file alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Two lines nearer than this, in lane widths, are one border between lanes: a double line, the
#: edges of one marking, or a line reported twice.
DOUBLE = 0.1

#: The clock of the rule and of its graph ticks in tenths of a second, whatever the frame rate. All
#: times and rates below are in ticks.
TICK_S = 0.1

#: A tick begins up to this long before it is due, so that the frames of a shaky clock that has ten
#: a second are a tick each.
EARLY = 0.25

#: The time, about, over which the mean displacement of the lines is their velocity.
INERTIA = 10.0

#: How long a pattern of lines counts in full, how quickly it counts less then, and how long it is
#: remembered. A pattern is how many lines are seen on either side of the car.
FRESH = 150.0
TIRES = 60.0
REMEMBERED = 800.0

#: The share of the time of a pattern that counts for those with fewer lines as well, because a
#: sensor misses lines.
OF_FEWER = 0.35

#: The most lines on a side that patterns tell apart.
MOST_BESIDE = 8


class LastFrame(NamedTuple):
    """What is kept of the frames so far to read the next one.

    - offset_m, lri: (L,) the lines of the last frame
    - is_real: whether there is one and it does not fill a gap
    - frame_id, time_s: of the last frame; its time is -infinity before the first one
    - before_m, before_kind, before_held: (M,) the lines of the last frame in which a tick began;
      none if it fills a gap
    - passed: ticks since then
    - velocity: of the lines, lane widths per tick
    - lines: (2,) the numbers of lines up to it that count, and of doubles among them
    """

    offset_m: FloatArray
    lri: FloatArray
    is_real: bool
    frame_id: int
    time_s: float
    before_m: FloatArray
    before_kind: IntArray
    before_held: BoolArray
    passed: float
    velocity: float
    lines: IntArray


@kernel()
def count_ticks(
    frame_id: IntArray, time_s: FloatArray, last: LastFrame
) -> tuple[IntArray, FloatArray, BoolArray, float]:
    """Return the ticks that begin with each frame, the weight of its evidence, whether frames are
    absent before it, (T,) each, and the time since the last tick.

    The errors of a detector last for seconds, not for frames, so a frame weighs the time since the
    frame before, in ticks; 1 if unknown. Absent frames are frames without lines. They count if they
    span a tick, and the frame after them weighs what a frame weighs.

    - frame_id, time_s: (T,)
    - last: the frame before the first
    """
    n_frames = len(time_s)
    ticks = np.empty(n_frames, dtype=np.int64)
    weights = np.empty(n_frames)
    is_after_gap = np.empty(n_frames, dtype=np.bool_)
    id_before = last.frame_id
    before_s = last.time_s
    passed = last.passed
    for t in range(n_frames):
        since = (time_s[t] - before_s) / TICK_S
        # Times are quotients; after rounding, ten frames per second weigh exactly 1.
        since = np.rint(since * 1e6) / 1e6 if 0 < since < math.inf else 1.0
        steps = frame_id[t] - id_before if before_s > -math.inf else 1
        passed += since
        ticks[t] = math.floor(passed + EARLY)
        passed -= ticks[t]
        is_after_gap[t] = steps > 1 and ticks[t] > 1
        weights[t] = max(since / steps, 1.0) if is_after_gap[t] else since
        id_before = frame_id[t]
        before_s = time_s[t]
    return ticks, weights, is_after_gap, passed


@kernel()
def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    is_missing: BoolArray,
    ticks: IntArray,
    is_after_gap: BoolArray,
    repeats_are_held: bool,
    width_m: FloatArray,
    farthest: float,
    reach: float,
    last: LastFrame,
) -> tuple[BoolArray, FloatArray, int]:
    """Return is_held (T, L), displacement (T,) since the frame in which the tick before began, NaN
    if unknown or if no tick begins, and the last frame in which one does, -1 if none does.

    - kind: (T, L) the class of the line, -1 in padding; set to -1 for lines too far away
    - ticks, is_after_gap: (T,) as from `count_ticks`
    - repeats_are_held: whether a line that repeats its offset is held for any LRI
    - width_m: (T,) of a lane; the distances below and the displacement are in lane widths
    - farthest: lines at this distance or farther do not count
    - reach: largest distance between matched lines
    - last: the frame before the first
    """
    n_frames, n_lines = offset_m.shape
    moves = np.empty(n_lines)
    is_held = np.empty((n_frames, n_lines), dtype=np.bool_)
    displacement = np.empty(n_frames)
    begin = -1
    for t in range(n_frames):
        farthest_m = farthest * width_m[t]
        reach_m = reach * width_m[t]
        displacement[t] = np.nan
        for i in range(n_lines):
            is_held[t, i] = False
            if not abs(offset_m[t, i]) < farthest_m:
                kind[t, i] = -1
        is_known = not is_missing[t] and not is_after_gap[t]
        if is_known and (last.is_real if t == 0 else not is_missing[t - 1]):
            just_m = last.offset_m if t == 0 else offset_m[t - 1]
            just_lri = last.lri if t == 0 else lri[t - 1]
            for i in range(n_lines):
                for j in range(len(just_m)):
                    if offset_m[t, i] == just_m[j] and (
                        repeats_are_held or lri[t, i] < just_lri[j]
                    ):
                        is_held[t, i] = True
        if ticks[t] == 0:
            continue
        before_m = last.before_m if begin < 0 else offset_m[begin]
        before_kind = last.before_kind if begin < 0 else kind[begin]
        before_held = last.before_held if begin < 0 else is_held[begin]
        # Neither a frame that fills a gap nor the one after it shows motion.
        n_before = 0 if begin >= 0 and is_missing[begin] else len(before_m)
        begin = t
        if not is_known:
            continue
        # Lines measured in both frames; without any, a new measurement of a line that was held.
        for take_held in (False, True):
            n_moves = 0
            for i in range(n_lines):
                if kind[t, i] < 0 or is_held[t, i]:
                    continue
                nearest = reach_m
                match = -1
                for j in range(n_before):
                    if before_kind[j] < 0 or (before_held[j] and not take_held):
                        continue
                    distance = abs(offset_m[t, i] - before_m[j])
                    if distance < nearest:
                        nearest = distance
                        match = j
                if match < 0:
                    continue
                is_mutual = True
                for other in range(n_lines):
                    if other == i or kind[t, other] < 0 or is_held[t, other]:
                        continue
                    if abs(offset_m[t, other] - before_m[match]) < nearest:
                        is_mutual = False
                if is_mutual:
                    move = offset_m[t, i] - before_m[match]
                    # In rising order; numba takes seconds to compile `np.median`.
                    at = n_moves
                    while at > 0 and moves[at - 1] > move:
                        moves[at] = moves[at - 1]
                        at -= 1
                    moves[at] = move
                    n_moves += 1
            if n_moves:
                middle = moves[n_moves // 2]
                if n_moves % 2 == 0:
                    middle = (moves[n_moves // 2 - 1] + middle) / 2
                displacement[t] = middle / width_m[t]
                break
    return is_held, displacement, begin


@kernel()
def coast(
    displacement: FloatArray, ticks: IntArray, farthest: float, kept: float, first: float
) -> FloatArray:
    """Return the velocity of the lines (T + 1,), before each frame and after the last one: the
    mean displacement of late, in which each tick counts 1 / INERTIA.

    - displacement: (T,) NaN if unknown
    - ticks: (T,) that begin with the frame
    - farthest: a larger displacement counts as unknown
    - kept: the share of the velocity that is left after a tick without displacement
    - first: the velocity before the first frame
    """
    velocity = np.empty(len(displacement) + 1)
    now = first
    velocity[0] = now
    for t in range(len(displacement)):
        if abs(displacement[t]) < farthest:
            now += (displacement[t] / ticks[t] - now) * (1 - (1 - 1 / INERTIA) ** ticks[t])
        else:
            now *= kept ** ticks[t]
        velocity[t + 1] = now
    return velocity


@kernel()
def find_doubles(
    offset_m: FloatArray, kind: IntArray, width_m: FloatArray, before: IntArray
) -> tuple[BoolArray, IntArray]:
    """Return whether a better line is nearer than `DOUBLE` lane widths, (T, L), and the numbers of
    lines and of such doubles up to each frame, (T + 1, 2), from `before` (2,) on.

    A line is better if its class is; in the same class, if it is nearer to the vehicle, or else
    listed first.
    """
    n_frames, n_lines = offset_m.shape
    is_double = np.empty((n_frames, n_lines), dtype=np.bool_)
    lines = np.empty((n_frames + 1, 2), dtype=np.int64)
    lines[0, 0] = before[0]
    lines[0, 1] = before[1]
    for t in range(n_frames):
        lines[t + 1, 0] = lines[t, 0]
        lines[t + 1, 1] = lines[t, 1]
        for i in range(n_lines):
            is_double[t, i] = False
            if kind[t, i] < 0:
                continue
            for j in range(n_lines):
                if j == i or kind[t, j] < 0 or kind[t, j] > kind[t, i]:
                    continue
                if not abs(offset_m[t, i] - offset_m[t, j]) < DOUBLE * width_m[t]:
                    continue
                here = abs(offset_m[t, i])
                there = abs(offset_m[t, j])
                if kind[t, j] < kind[t, i] or there < here or (there == here and j < i):
                    is_double[t, i] = True
            lines[t + 1, 0] += 1
            lines[t + 1, 1] += is_double[t, i]
    return is_double, lines


@kernel()
def weigh_positions(
    offset_m: FloatArray,
    kind: IntArray,
    width_m: FloatArray,
    log_intensity: FloatArray,
    log_mean: FloatArray,
    first_m: float,
    step_m: float,
    expected: FloatArray,
    model_width_m: float,
    alpha: float,
    beta: float,
    weights: FloatArray,
    is_missing: BoolArray,
    lane_changes: float,
    kind_changes: float,
    visibility: FloatArray,
    patterns: FloatArray,
    likelihood: FloatArray,
    last_kind: FloatArray,
) -> None:
    """Fill likelihood (T, n cells, 2); the maximum of each frame is 1. A mean over the lane widths
    and over the kinds of detectors, which are followed in `visibility`.

    What a sensor never shows is one fact about it, so a pattern of lines that has been seen for
    long counts little.

    - kind: (T, L) the line's class, -1 where it does not count
    - width_m: (T, W) equally probable lane widths, in rising order
    - alpha, beta: exponents of a frame that weighs 1
    - log_intensity, log_mean, first_m, step_m, expected, model_width_m: as in
      `visibility.VisibilityTables`; lines are scaled to its width
    - weights: (T,) ticks
    - is_missing: (T,) frames without evidence
    - lane_changes, kind_changes: probabilities in a tick
    - visibility: (n, K) the belief over lane and kind; becomes that after the last frame
    - patterns: (M, M) how long each pattern has been seen of late, ticks; becomes that after the
      last frame
    - last_kind: (T,) output, the probability of the last kind before each frame
    """
    n_frames, n_lines = offset_m.shape
    n_lanes, n_kinds = visibility.shape
    n_states = n_lanes * n_kinds
    n_widths = width_m.shape[1]
    cells = likelihood.shape[1] // n_lanes
    of_state = np.empty((n_widths, cells * n_states))
    mean = np.empty((n_widths, cells))
    weight = np.empty(n_widths)
    spare = np.empty((n_lanes, n_kinds))
    place = np.empty(cells)
    expected_mean = 0.0
    for k in range(n_kinds):
        for lane in range(n_lanes):
            expected_mean += expected[k, lane]
    expected_mean /= n_states
    cell = model_width_m / cells / step_m
    last = log_mean.shape[1] - 2
    for t in range(n_frames):
        # Limited so that no line counts more than once.
        of_kind = min(alpha * weights[t], max(alpha, 1.0))
        of_place = min(beta * weights[t], max(beta, 1.0))
        fresh = _freshness(patterns, offset_m[t], kind[t], weights[t])
        # A frame without lines is evidence of nothing.
        if is_missing[t] or fresh == 0.0:
            of_kind = 0.0
        of_lane = fresh * of_kind
        # Equal widths are one.
        n = 0
        k = 0
        while k < n_widths:
            same = 1
            while k + same < n_widths and width_m[t, k + same] == width_m[t, k]:
                same += 1
            weight[n] = same / n_widths
            scale = model_width_m / width_m[t, k]
            for r in range(cells * n_states):
                of_state[n, r] = 0.0
            for u in range(cells):
                mean[n, u] = 0.0
            for i in range(n_lines):
                c = kind[t, i]
                if c < 0:
                    continue
                # z of the leftmost cell's centre, in steps of the tables.
                start = (offset_m[t, i] * scale - 0.5 * model_width_m - first_m) / step_m
                start += 0.5 * cell
                for u in range(cells):
                    at = min(max(start + u * cell, 0.0), last)
                    z = int(at)
                    right = at - z
                    below = log_intensity[c, z]
                    above = log_intensity[c, z + 1]
                    target = of_state[n, u * n_states : (u + 1) * n_states]
                    for s in range(n_states):
                        target[s] += below[s] + right * (above[s] - below[s])
                    before = log_mean[c, z]
                    mean[n, u] += before + right * (log_mean[c, z + 1] - before)
            n += 1
            k += same
        if n > 1:
            _mix(weight, mean, n)
            _mix(weight, of_state, n)
        # Entry (u n_kinds + k) n_lanes + lane.
        known = of_state[0]
        for u in range(cells):
            for k in range(n_kinds):
                for lane in range(n_lanes):
                    s = (u * n_kinds + k) * n_lanes + lane
                    known[s] += expected_mean - expected[k, lane] - mean[0, u]
        last_kind[t] = visibility[:, -1].sum()
        to_side = min(lane_changes * weights[t], 0.3)
        to_any = min(kind_changes * weights[t], 0.3)
        _change(visibility, to_side, to_any, spare)
        largest = -np.inf
        for u in range(cells):
            phase_only = of_place * mean[0, u]
            largest = max(largest, phase_only)
            for lane in range(n_lanes):
                top = -np.inf
                for k in range(n_kinds):
                    top = max(top, known[(u * n_kinds + k) * n_lanes + lane])
                total = 0.0
                share = 0.0
                for k in range(n_kinds):
                    away = known[(u * n_kinds + k) * n_lanes + lane] - top
                    total += visibility[lane, k] * math.exp(of_lane * away)
                    share += visibility[lane, k]
                total /= share
                likelihood[t, lane * cells + u, 0] = phase_only + of_lane * top + math.log(total)
                likelihood[t, lane * cells + u, 1] = phase_only
                largest = max(largest, likelihood[t, lane * cells + u, 0])
        for r in range(n_lanes * cells):
            likelihood[t, r, 0] = math.exp(likelihood[t, r, 0] - largest)
            likelihood[t, r, 1] = math.exp(likelihood[t, r, 1] - largest)
        if n_kinds > 1:
            _learn(visibility, known, mean[0], of_kind, place, spare)


@kernel(no_cpython_wrapper=True)
def _freshness(patterns: FloatArray, offset_m: FloatArray, kind: IntArray, weight: float) -> float:
    """Return how much a frame's pattern still counts, 0 to 1 (0 without lines), and add the frame
    to `patterns`.

    - offset_m, kind: (L,)
    """
    left = 0
    right = 0
    for i in range(len(kind)):
        if kind[i] >= 0 and offset_m[i] < 0:
            left = min(left + 1, MOST_BESIDE)
        elif kind[i] >= 0:
            right = min(right + 1, MOST_BESIDE)
    fresh = 0.0
    if left + right > 0:
        seen = (1 - OF_FEWER) * patterns[left, right] + OF_FEWER * patterns[left:, right:].sum()
        fresh = (1 + max(seen - FRESH, 0.0) / TIRES) ** -2
    patterns *= math.exp(-weight / REMEMBERED)
    patterns[left, right] += weight
    return fresh


@kernel(no_cpython_wrapper=True)
def _change(visibility: FloatArray, to_side: float, to_any: float, before: FloatArray) -> None:
    """Predict the belief (n, K) over lane and kind.

    - to_side: probability that the car goes to the lane on the left, and on the right
    - to_any: probability that the kind is any again
    - before: (n, K), overwritten
    """
    n_lanes, n_kinds = visibility.shape
    for lane in range(n_lanes):
        for k in range(n_kinds):
            before[lane, k] = visibility[lane, k]
    for lane in range(n_lanes):
        left = max(lane - 1, 0)
        right = min(lane + 1, n_lanes - 1)
        total = 0.0
        for k in range(n_kinds):
            stays = (1 - 2 * to_side) * before[lane, k]
            visibility[lane, k] = stays + to_side * (before[left, k] + before[right, k])
            total += visibility[lane, k]
        spread = to_any * total / n_kinds
        for k in range(n_kinds):
            visibility[lane, k] = (1 - to_any) * visibility[lane, k] + spread


@kernel(no_cpython_wrapper=True)
def _learn(
    visibility: FloatArray,
    known: FloatArray,
    mean: FloatArray,
    alpha: float,
    place: FloatArray,
    support: FloatArray,
) -> None:
    """Weigh the belief (n, K) over lane and kind with a frame.

    - known: (cells K n,) logarithm of the frame's likelihood relative to the mean one
    - mean: (cells,) logarithm of the mean likelihood; evidence of the place in the lane
    - place, support: (cells,), (n, K), overwritten
    """
    n_lanes, n_kinds = visibility.shape
    cells = len(mean)
    top = -np.inf
    for u in range(cells):
        top = max(top, mean[u])
    total = 0.0
    for u in range(cells):
        place[u] = math.exp(mean[u] - top)
        total += place[u]
    for u in range(cells):
        place[u] /= total
    largest = -np.inf
    for lane in range(n_lanes):
        for k in range(n_kinds):
            top = -np.inf
            for u in range(cells):
                top = max(top, known[(u * n_kinds + k) * n_lanes + lane])
            total = 0.0
            for u in range(cells):
                away = known[(u * n_kinds + k) * n_lanes + lane] - top
                total += place[u] * math.exp(away)
            # The best place may have no share that is a number.
            support[lane, k] = alpha * (top + math.log(max(total, 1e-300)))
            largest = max(largest, support[lane, k])
    total = 0.0
    for lane in range(n_lanes):
        for k in range(n_kinds):
            visibility[lane, k] *= math.exp(support[lane, k] - largest)
            total += visibility[lane, k]
    for lane in range(n_lanes):
        for k in range(n_kinds):
            visibility[lane, k] /= total


@kernel(no_cpython_wrapper=True)
def _mix(weight: FloatArray, log_value: FloatArray, n: int) -> None:
    """Write the logarithm of the weighted mean of the first n rows of log_value (K, C) into its
    first row."""
    for u in range(log_value.shape[1]):
        largest = log_value[0, u]
        for k in range(1, n):
            largest = max(largest, log_value[k, u])
        total = 0.0
        for k in range(n):
            # The exp of the largest need not be computed.
            below = log_value[k, u] - largest
            total += weight[k] * (math.exp(below) if below else 1.0)
        log_value[0, u] = largest + math.log(total)


#: Beyond this many standard deviations a normal density counts as 0.
_FAR = 12.0


@kernel()
def expected_counts(
    offset_m: FloatArray,
    kind: IntArray,
    lane: IntArray,
    place_m: FloatArray,
    rates: FloatArray,
    class_shares: FloatArray,
    sigmas_m: FloatArray,
    clutter: FloatArray,
    width_m: float,
    cells: int,
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the log likelihood without the expected numbers of lines, and the expected counts
    lines (n, K), classes (K, 4), moments (3, K) and of clutter (4,), as in `fitting.Statistics`."""
    n_frames, n_slots = offset_m.shape
    n_lines = rates.shape[1]
    lines = np.zeros(rates.shape)
    classes = np.zeros(class_shares.shape)
    moments = np.zeros((3, n_lines))
    of_clutter = np.zeros(len(clutter))
    log_place = np.empty(cells)
    share = np.empty((n_slots, cells, n_lines + 1))
    log_likelihood = 0.0
    for t in range(n_frames):
        own = lane[t]
        for u in range(cells):
            log_place[u] = -math.log(cells)
        for i in range(n_slots):
            c = kind[t, i]
            if c < 0:
                continue
            for u in range(cells):
                z = offset_m[t, i] + ((u + 0.5) / cells - 0.5) * width_m
                total = max(clutter[c], 1e-12)
                share[i, u, n_lines] = total
                for k in range(n_lines):
                    away = (z - place_m[own, k]) / sigmas_m[k]
                    density = 0.0
                    if abs(away) < _FAR:
                        density = math.exp(-0.5 * away * away) / (
                            sigmas_m[k] * math.sqrt(2 * math.pi)
                        )
                    share[i, u, k] = rates[own, k] * class_shares[k, c] * density
                    total += share[i, u, k]
                log_place[u] += math.log(total)
                for k in range(n_lines + 1):
                    share[i, u, k] /= total
        largest = log_place.max()
        total = 0.0
        for u in range(cells):
            log_place[u] = math.exp(log_place[u] - largest)
            total += log_place[u]
        log_likelihood += largest + math.log(total)
        for i in range(n_slots):
            c = kind[t, i]
            if c < 0:
                continue
            for u in range(cells):
                weight = log_place[u] / total
                z = offset_m[t, i] + ((u + 0.5) / cells - 0.5) * width_m
                for k in range(n_lines):
                    part = weight * share[i, u, k]
                    away = z - place_m[own, k]
                    lines[own, k] += part
                    classes[k, c] += part
                    moments[0, k] += part
                    moments[1, k] += part * away
                    moments[2, k] += part * away * away
                of_clutter[c] += weight * share[i, u, n_lines]
    return log_likelihood, lines, classes, moments, of_clutter
