"""The numba kernels of `line_geometry`."""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray


@kernel()
def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    follows: BoolArray,
    reach_m: FloatArray,
    is_held: BoolArray,
    displacement_m: FloatArray,
) -> None:
    """Fills is_held (T, L) and displacement_m (T,), which is NaN where it is unknown.

    - kind: (T, L) the line's class, -1 where there is none
    - follows: (T,) whether the frame comes right after the one before
    - reach_m: (T,) largest distance between matched lines
    """
    n_frames, n_lines = offset_m.shape
    moves = np.empty(n_lines)
    for t in range(n_frames):
        displacement_m[t] = np.nan
        for i in range(n_lines):
            is_held[t, i] = False
        if t == 0 or not follows[t]:
            continue
        for i in range(n_lines):
            for j in range(n_lines):
                if offset_m[t, i] == offset_m[t - 1, j] and lri[t, i] < lri[t - 1, j]:
                    is_held[t, i] = True
        # Lines measured in both frames; without any, a new measurement of a line that was held.
        for take_held in (False, True):
            n_moves = 0
            for i in range(n_lines):
                if kind[t, i] < 0 or is_held[t, i]:
                    continue
                nearest = reach_m[t]
                match = -1
                for j in range(n_lines):
                    if kind[t - 1, j] < 0 or (is_held[t - 1, j] and not take_held):
                        continue
                    distance = abs(offset_m[t, i] - offset_m[t - 1, j])
                    if distance < nearest:
                        nearest = distance
                        match = j
                if match < 0:
                    continue
                is_mutual = True
                for other in range(n_lines):
                    if other == i or kind[t, other] < 0 or is_held[t, other]:
                        continue
                    if abs(offset_m[t, other] - offset_m[t - 1, match]) < nearest:
                        is_mutual = False
                if is_mutual:
                    moves[n_moves] = offset_m[t, i] - offset_m[t - 1, match]
                    n_moves += 1
            if n_moves:
                displacement_m[t] = np.median(moves[:n_moves])
                break


@kernel()
def drop_doubles(offset_m: FloatArray, kind: IntArray, near_m: FloatArray) -> None:
    """Sets kind (T, L) to -1 where a better line is nearer than near_m (T,). A line is better if
    its class is better; in the same class, if it is nearer to the vehicle, or else listed first."""
    n_frames, n_lines = offset_m.shape
    is_double = np.empty(n_lines, dtype=np.bool_)
    for t in range(n_frames):
        for i in range(n_lines):
            is_double[i] = False
            if kind[t, i] < 0:
                continue
            for j in range(n_lines):
                if j == i or kind[t, j] < 0 or kind[t, j] > kind[t, i]:
                    continue
                if not abs(offset_m[t, i] - offset_m[t, j]) < near_m[t]:
                    continue
                here, there = abs(offset_m[t, i]), abs(offset_m[t, j])
                if kind[t, j] < kind[t, i] or there < here or (there == here and j < i):
                    is_double[i] = True
        for i in range(n_lines):
            if is_double[i]:
                kind[t, i] = -1


@kernel()
def weigh_positions(
    offset_m: FloatArray,
    kind: IntArray,
    log_intensity: FloatArray,
    log_mean: FloatArray,
    first_m: float,
    step_m: float,
    expected: FloatArray,
    width_m: float,
    alpha: FloatArray,
    beta: FloatArray,
    likelihood: FloatArray,
) -> None:
    """Fills likelihood (T, n cells, 2); the maximum of each frame is 1.

    - kind: (T, L) the line's class, -1 where it does not count
    - alpha, beta: (T,) exponents of each frame
    - log_intensity, log_mean, first_m, step_m, expected, width_m: as in `model.LineTables`
    """
    n_frames, n_lines = offset_m.shape
    n_lanes = log_intensity.shape[0]
    cells = likelihood.shape[1] // n_lanes
    of_lane = np.empty((n_lanes, cells))
    mean = np.empty(cells)
    expected_mean = expected.mean()
    cell_m = width_m / cells
    for t in range(n_frames):
        of_lane[:] = 0.0
        mean[:] = 0.0
        for i in range(n_lines):
            c = kind[t, i]
            if c < 0:
                continue
            # z of the leftmost cell's centre, in steps of the tables.
            start = (offset_m[t, i] + (0.5 * cell_m - 0.5 * width_m) - first_m) / step_m
            for u in range(cells):
                at = start + u * (cell_m / step_m)
                z = int(at)
                right = at - z
                for lane in range(n_lanes):
                    below = log_intensity[lane, c, z]
                    of_lane[lane, u] += below + right * (log_intensity[lane, c, z + 1] - below)
                below = log_mean[c, z]
                mean[u] += below + right * (log_mean[c, z + 1] - below)
        largest = -np.inf
        for u in range(cells):
            largest = max(largest, beta[t] * mean[u])
            for lane in range(n_lanes):
                known = of_lane[lane, u] - expected[lane] - mean[u] + expected_mean
                of_lane[lane, u] = beta[t] * mean[u] + alpha[t] * known
                largest = max(largest, of_lane[lane, u])
        for u in range(cells):
            phase_only = math.exp(beta[t] * mean[u] - largest)
            for lane in range(n_lanes):
                likelihood[t, lane * cells + u, 0] = math.exp(of_lane[lane, u] - largest)
                likelihood[t, lane * cells + u, 1] = phase_only


#: Beyond so many standard deviations a normal is nothing.
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
