"""The numba kernel of `_line_em`: the E step."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from egolane_pgm.types import FloatArray, IntArray

#: Beyond so many standard deviations a normal is nothing.
_FAR = 12.0


@njit(cache=True)
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
    """Add to lines (n, K), classes (K, 4), moments (3, K) and of_clutter (4,); returns the log
    likelihood without the expected numbers of lines."""
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
