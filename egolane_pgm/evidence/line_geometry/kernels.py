"""The numba kernels of `line_geometry`."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@kernel()
def classify(
    offset_m: FloatArray,
    is_valid: BoolArray,
    is_continuous: BoolArray,
    lri: FloatArray,
    strong_lri: float,
    least_lri: float,
    placeholder_m: float,
    kind: IntArray,
    is_strong: BoolArray,
) -> None:
    """Fills kind (T, L) as `model` defines the classes, -1 where there is no line, and is_strong
    (T, L): whether a line's place is reliable. An unknown LRI counts as the highest."""
    n_frames, n_lines = offset_m.shape
    for t in range(n_frames):
        for i in range(n_lines):
            kind[t, i] = -1
            is_strong[t, i] = False
            if not placeholder_m < abs(offset_m[t, i]) < math.inf:
                continue
            is_reliable = not lri[t, i] < strong_lri
            if is_valid[t, i]:
                is_strong[t, i] = is_reliable
                kind[t, i] = 0 if is_continuous[t, i] else 1 if is_reliable else 2
            elif not lri[t, i] < least_lri:
                kind[t, i] = 3


@kernel()
def follow_width(
    offset_m: FloatArray,
    is_strong: BoolArray,
    steady: FloatArray,
    wandering: FloatArray,
    pairs: FloatArray,
    counts: FloatArray,
    prior: FloatArray,
    log_likelihood: FloatArray,
    is_two_lanes: FloatArray,
    first: int,
    spread: FloatArray,
    rates: FloatArray,
    least_double: float,
    enough_pairs: float,
    least_pairs: float,
    log_narrowest: float,
    step: float,
    width_m: FloatArray,
) -> None:
    """Fills width_m (T, K) with quantiles of the lane width before each frame; the belief `steady`,
    `wandering`, `pairs`, `counts` becomes that after the last one.

    Belief and prior are those of `scale.WidthBelief`, the tables and rates are
    constants of `scale`. least_double: a gap of less than this share of the frame's largest
    one is a line reported twice.
    """
    moves, moves_wandering, another, returns, may_wander, changes = rates[:6]
    kept, alike, alike_wandering = rates[6:9]
    n_frames, n_lines = offset_m.shape
    n_widths, n_table, n_quantiles = len(prior), len(log_likelihood), width_m.shape[1]
    half = len(spread) // 2
    lines = np.empty(n_lines)
    moved = np.empty(n_widths)
    around = np.empty(n_widths)
    says = np.empty(n_widths)
    off_table = log_likelihood[0]
    for t in range(n_frames):
        # Predict.
        moved[0], moved[-1] = steady[0], steady[-1]
        for j in range(1, n_widths - 1):
            moved[j] = steady[j] + moves * (steady[j - 1] - 2 * steady[j] + steady[j + 1])
        for j in range(n_widths):
            steady[j] = moved[j] + another * (prior[j] - moved[j])
        # A width by which no two neighbouring lanes are ever seen at once is impossible. The factor
        # is so small because other widths may have sunk to `another`.
        total = 0.0
        for j in range(n_widths):
            if counts[1] >= enough_pairs and pairs[j] < least_pairs * counts[1]:
                steady[j] *= 1e-60
            moved[j] = steady[j]
            total += moved[j]
        around[:] = 0.0
        for j in range(n_widths):
            moved[j] /= total
            if moved[j] > 1e-6:
                for d in range(max(-half, -j), min(half, n_widths - 1 - j) + 1):
                    around[j + d] += moved[j] * spread[d + half]
        left = wandering[0]
        total = 0.0
        for j in range(n_widths):
            here = wandering[j]
            right = wandering[j + 1] if j + 1 < n_widths else here
            new = here + moves_wandering * (left - 2 * here + right)
            wandering[j] = new + returns * (around[j] - new)
            if counts[1] >= enough_pairs and pairs[j] < least_pairs * counts[1]:
                wandering[j] *= 1e-60
            total += wandering[j]
            left = here
        for j in range(n_widths):
            wandering[j] /= total
        counts[0] += changes * (may_wander - counts[0])
        # The quantiles of the mixture.
        below = 0.0
        k = 0
        for j in range(n_widths):
            below += counts[0] * wandering[j] + (1 - counts[0]) * moved[j]
            while k < n_quantiles and below * n_quantiles >= k + 0.5:
                width_m[t, k] = math.exp(log_narrowest + step * j)
                k += 1
        # The gaps of this frame.
        n = 0
        for i in range(n_lines):
            if is_strong[t, i]:
                lines[n] = offset_m[t, i]
                n += 1
        if n < 2:
            continue
        lines[:n].sort()
        largest = 0.0
        for i in range(n - 1):
            largest = max(largest, lines[i + 1] - lines[i])
        single = 1
        for i in range(1, n):
            if lines[i] - lines[single - 1] > least_double * largest:
                lines[single] = lines[i]
                single += 1
        for j in range(n_widths):
            pairs[j] *= kept
            says[j] = 0.0
        counts[1] *= kept
        n_gaps = 0
        for apart in (1, 2):
            for i in range(single - apart):
                gap = lines[i + apart] - lines[i]
                if gap == math.inf:
                    continue
                n_gaps += 1
                if apart == 2:
                    counts[1] += 1
                start = round((math.log(gap) - log_narrowest) / step) - first
                # Widths so far away that the gap is off the table are alike.
                for j in range(max(0, start - n_table + 1), min(n_widths, start + 1)):
                    says[j] += log_likelihood[start - j] - off_table
                    if apart == 2:
                        pairs[j] += is_two_lanes[start - j]
        if n_gaps == 0:
            continue
        most = 0.0
        for j in range(n_widths):
            most = max(most, says[j])
        of_steady = 0.0
        of_wandering = 0.0
        total = 0.0
        total_wandering = 0.0
        for j in range(n_widths):
            # The gaps say the same of most neighbours, and exp takes longer than the rest.
            if j == 0 or says[j] != says[j - 1]:
                likelihood = math.exp((says[j] - most) / alike)
                quick = math.exp((says[j] - most) / alike_wandering)
            of_steady += moved[j] * quick
            of_wandering += wandering[j] * quick
            steady[j] *= likelihood
            total += steady[j]
            wandering[j] *= quick
            total_wandering += wandering[j]
        for j in range(n_widths):
            steady[j] /= total
            wandering[j] /= total_wandering
        of_wandering *= counts[0]
        counts[0] = of_wandering / (of_wandering + (1 - counts[0]) * of_steady)


@kernel()
def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    frame_id: IntArray,
    is_missing: BoolArray,
    repeats_are_held: bool,
    width_m: FloatArray,
    farthest: float,
    reach: float,
    last_offset_m: FloatArray,
    last_kind: IntArray,
    last_lri: FloatArray,
    last_is_held: BoolArray,
    last_id: int,
    last_state: int,
    is_held: BoolArray,
    displacement: FloatArray,
    steps: IntArray,
) -> None:
    """Fills is_held (T, L), displacement (T,), NaN where it is unknown, and steps (T,): frames
    since the frame before.

    - kind: (T, L) the line's class, -1 where there is none; becomes -1 where a line is too far away
    - repeats_are_held: whether a line that repeats its offset is held whatever its LRI
    - width_m: (T,) of a lane; the distances below and the displacement are in lane widths
    - farthest: lines at this distance or farther do not count
    - reach: largest distance between matched lines
    - last_...: as in `reading.LastFrame`, of the frame before the first
    """
    n_frames, n_lines = offset_m.shape
    moves = np.empty(n_lines)
    for t in range(n_frames):
        displacement[t] = np.nan
        farthest_m, reach_m = farthest * width_m[t], reach * width_m[t]
        for i in range(n_lines):
            is_held[t, i] = False
            if not abs(offset_m[t, i]) < farthest_m:
                kind[t, i] = -1
        if t == 0:
            before_m, before_kind, before_lri = last_offset_m, last_kind, last_lri
            before_held = last_is_held
            steps[t] = frame_id[t] - last_id if last_state >= 0 else 1
            follows = last_state == 1
        else:
            before_m, before_kind, before_lri = offset_m[t - 1], kind[t - 1], lri[t - 1]
            before_held = is_held[t - 1]
            steps[t] = frame_id[t] - frame_id[t - 1]
            follows = not is_missing[t - 1]
        # Neither a frame that fills a gap nor the one after it shows motion.
        if not follows or is_missing[t] or steps[t] != 1:
            continue
        n_before = len(before_m)
        for i in range(n_lines):
            for j in range(n_before):
                if offset_m[t, i] == before_m[j] and (
                    repeats_are_held or lri[t, i] < before_lri[j]
                ):
                    is_held[t, i] = True
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
                    moves[n_moves] = offset_m[t, i] - before_m[match]
                    n_moves += 1
            if n_moves:
                displacement[t] = np.median(moves[:n_moves]) / width_m[t]
                break


@kernel()
def coast(
    displacement: FloatArray,
    steps: IntArray,
    farthest: float,
    inertia: float,
    kept: float,
    velocity: FloatArray,
) -> None:
    """Fills velocity (T + 1,) with that of the lines before each frame and after the last one: the
    mean displacement of late, in which each frame counts 1 / inertia.

    - displacement: (T,) since the frame before, NaN where it is unknown
    - steps: (T,) frames since the frame before
    - farthest: a larger displacement counts as unknown
    - kept: the share of the velocity that is left after a frame without displacement
    - velocity: its first value is that before the first frame
    """
    now = velocity[0]
    for t in range(len(displacement)):
        if steps[t] == 1 and abs(displacement[t]) < farthest:
            now += (displacement[t] - now) / inertia
        else:
            now *= kept ** steps[t]
        velocity[t + 1] = now


@kernel()
def weigh_frames(
    time_s: FloatArray, is_missing: BoolArray, usual_s: float, last_s: float, weights: FloatArray
) -> float:
    """Fills weights (T,) with the time since the last frame that is not missing, over usual_s; 1
    where it is unknown. Returns the time of the last such frame.

    - time_s, is_missing: (T,)
    - last_s: the time of the last such frame before the first, or -infinity
    """
    for t in range(len(weights)):
        passed = time_s[t] - last_s
        # Times are quotients; after rounding, ten frames per second weigh exactly 1.
        is_known = 0 < passed < math.inf
        weights[t] = np.rint(passed / usual_s * 1e6) / 1e6 if is_known else 1.0
        if not is_missing[t] and time_s[t] > last_s:
            last_s = time_s[t]
    return last_s


@kernel()
def find_doubles(
    offset_m: FloatArray,
    kind: IntArray,
    width_m: FloatArray,
    near: float,
    is_double: BoolArray,
    lines: IntArray,
) -> None:
    """Fills is_double (T, L): whether a better line is nearer than `near` lane widths. A line is
    better if its class is; in the same class, if it is nearer to the vehicle, or else listed first.

    - lines: (T + 1, 2) the numbers of lines and of doubles so far; the first row is given
    """
    n_frames, n_lines = offset_m.shape
    for t in range(n_frames):
        lines[t + 1] = lines[t]
        for i in range(n_lines):
            is_double[t, i] = False
            if kind[t, i] < 0:
                continue
            for j in range(n_lines):
                if j == i or kind[t, j] < 0 or kind[t, j] > kind[t, i]:
                    continue
                if not abs(offset_m[t, i] - offset_m[t, j]) < near * width_m[t]:
                    continue
                here, there = abs(offset_m[t, i]), abs(offset_m[t, j])
                if kind[t, j] < kind[t, i] or there < here or (there == here and j < i):
                    is_double[t, i] = True
            lines[t + 1, 0] += 1
            lines[t + 1, 1] += is_double[t, i]


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
    tenths: FloatArray,
    is_missing: BoolArray,
    lane_changes: float,
    kind_changes: float,
    sight: FloatArray,
    likelihood: FloatArray,
) -> None:
    """Fills likelihood (T, n cells, 2); the maximum of each frame is 1. A mean over the lane widths
    and over the kinds of detectors, which are followed in `sight`.

    - kind: (T, L) the line's class, -1 where it does not count
    - width_m: (T, W) equally probable lane widths, in rising order
    - alpha, beta: exponents of a frame a tenth of a second after the one before
    - log_intensity, log_mean, first_m, step_m, expected, model_width_m: as in `sight.SightTables`;
      lines are scaled to its width
    - tenths: (T,) since the frame before, tenths of a second
    - is_missing: (T,) marks frames whose lines say nothing
    - lane_changes, kind_changes: probabilities in a tenth of a second
    - sight: (n, K) the belief over lane and kind; becomes that after the last frame
    """
    n_frames, n_lines = offset_m.shape
    n_lanes, n_kinds = sight.shape
    n_states, n_widths = n_lanes * n_kinds, width_m.shape[1]
    cells = likelihood.shape[1] // n_lanes
    of_state = np.empty((n_widths, cells * n_states))
    mean = np.empty((n_widths, cells))
    weight = np.empty(n_widths)
    expected_mean = expected.mean()
    cell = model_width_m / cells / step_m
    last = log_mean.shape[1] - 2
    for t in range(n_frames):
        # Limited so that no line counts more than once.
        of_lane = 0.0 if is_missing[t] else min(alpha * tenths[t], max(alpha, 1.0))
        of_place = min(beta * tenths[t], max(beta, 1.0))
        # Equal widths are one.
        n = 0
        k = 0
        while k < n_widths:
            same = 1
            while k + same < n_widths and width_m[t, k + same] == width_m[t, k]:
                same += 1
            weight[n] = same / n_widths
            scale = model_width_m / width_m[t, k]
            of_state[n] = 0.0
            mean[n] = 0.0
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
                    below, above = log_intensity[c, z], log_intensity[c, z + 1]
                    target = of_state[n, u * n_states : (u + 1) * n_states]
                    for s in range(n_states):
                        target[s] += below[s] + right * (above[s] - below[s])
                    before, after = log_mean[c, z], log_mean[c, z + 1]
                    mean[n, u] += before + right * (after - before)
            n += 1
            k += same
        if n > 1:
            _mix(weight, mean, n)
            _mix(weight, of_state, n)
        known = of_state[0].reshape(cells, n_kinds, n_lanes)
        for u in range(cells):
            for k in range(n_kinds):
                for lane in range(n_lanes):
                    known[u, k, lane] += expected_mean - expected[k, lane] - mean[0, u]
        _change(sight, min(lane_changes * tenths[t], 0.3), min(kind_changes * tenths[t], 0.3))
        lane_share = sight.sum(axis=1)
        largest = -np.inf
        for u in range(cells):
            phase_only = of_place * mean[0, u]
            largest = max(largest, phase_only)
            for lane in range(n_lanes):
                top = known[u, :, lane].max()
                total = 0.0
                for k in range(n_kinds):
                    total += sight[lane, k] * math.exp(of_lane * (known[u, k, lane] - top))
                total /= lane_share[lane]
                likelihood[t, lane * cells + u, 0] = phase_only + of_lane * top + math.log(total)
                likelihood[t, lane * cells + u, 1] = phase_only
                largest = max(largest, likelihood[t, lane * cells + u, 0])
        for r in range(n_lanes * cells):
            likelihood[t, r, 0] = math.exp(likelihood[t, r, 0] - largest)
            likelihood[t, r, 1] = math.exp(likelihood[t, r, 1] - largest)
        if n_kinds > 1:
            _learn(sight, known, mean[0], of_lane)


@kernel()
def _change(sight: FloatArray, to_side: float, to_any: float) -> None:
    """Predicts the belief (n, K) over lane and kind: the car goes to the lane on either side with
    one probability, and the kind is any again with another."""
    n_lanes, n_kinds = sight.shape
    before = sight.copy()
    for lane in range(n_lanes):
        left, right = max(lane - 1, 0), min(lane + 1, n_lanes - 1)
        for k in range(n_kinds):
            stays = (1 - 2 * to_side) * before[lane, k]
            sight[lane, k] = stays + to_side * (before[left, k] + before[right, k])
        spread = to_any * sight[lane].sum() / n_kinds
        for k in range(n_kinds):
            sight[lane, k] = (1 - to_any) * sight[lane, k] + spread


@kernel()
def _learn(sight: FloatArray, known: FloatArray, mean: FloatArray, alpha: float) -> None:
    """Weighs the belief (n, K) over lane and kind with a frame.

    - known: (cells, K, n) logarithm of the frame's likelihood relative to the mean one
    - mean: (cells,) logarithm of the mean likelihood; it says where in its lane the car is
    """
    n_lanes, n_kinds = sight.shape
    place = np.exp(mean - mean.max())
    place /= place.sum()
    says = np.empty(sight.shape)
    for lane in range(n_lanes):
        for k in range(n_kinds):
            top = known[:, k, lane].max()
            total = 0.0
            for u in range(len(mean)):
                total += place[u] * math.exp(known[u, k, lane] - top)
            # The best place may have no share that is a number.
            says[lane, k] = alpha * (top + math.log(max(total, 1e-300)))
    sight *= np.exp(says - says.max())
    sight /= sight.sum()


@kernel()
def _mix(weight: FloatArray, log_value: FloatArray, n: int) -> None:
    """Writes the logarithm of the weighted mean of the first n rows of log_value (K, C) into its
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
    sigma_m: FloatArray,
    clutter: FloatArray,
    width_m: float,
    cells: int,
    lines: FloatArray,
    classes: FloatArray,
    moments: FloatArray,
    of_clutter: FloatArray,
) -> float:
    """Adds expected counts to lines (n, K), classes (K, 4), moments (3, K) and of_clutter (4,), as
    in `fitting.Statistics`. Returns the log likelihood without the expected numbers of lines."""
    n_frames, n_slots = offset_m.shape
    n_lines = rates.shape[1]
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
                    away = (z - place_m[own, k]) / sigma_m[k]
                    density = 0.0
                    if abs(away) < _FAR:
                        density = math.exp(-0.5 * away * away) / (
                            sigma_m[k] * math.sqrt(2 * math.pi)
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
    return log_likelihood
