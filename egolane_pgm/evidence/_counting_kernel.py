"""The numba kernel of `counting`; the NumPy twin is there."""

from __future__ import annotations

from numba import njit

from egolane_pgm.types import BoolArray, FloatArray


@njit(cache=True)
def count_lines(
    offset_m: FloatArray,
    is_valid: BoolArray,
    is_continuous: BoolArray,
    lri: FloatArray,
    lane_width_m: float,
    bonus_value: float,
    tentative_noise: float,
    wor_noise: float,
    max_lri: float,
    ignore_frames_without_line: bool,
    tentative: FloatArray,
    wor: FloatArray,
) -> None:
    """Write tentative (T, n) and wor (T, 2) from the lines (T, L)."""
    n_lanes = tentative.shape[1]
    for t in range(offset_m.shape[0]):
        reliability = 0.0
        has_line = False
        total = 0.0
        for lane in range(n_lanes):
            tentative[t, lane] = 0.0
        for line in range(offset_m.shape[1]):
            if not is_valid[t, line]:
                continue
            has_line = True
            # NaN is not equal to itself: a line without an index counts as fully reliable.
            reliability += lri[t, line] if lri[t, line] == lri[t, line] else max_lri
            d = offset_m[t, line]
            distance = abs(d)
            if distance <= lane_width_m:
                if is_continuous[t, line]:
                    lane = 0 if d < 0 else n_lanes - 1
                    tentative[t, lane] += bonus_value
                    total += bonus_value
                continue
            for k in range(n_lanes):
                if distance < (k + 1) * lane_width_m:
                    tentative[t, n_lanes - 1 - k if d > 0 else k] += 1.0
                    total += 1.0
            if is_continuous[t, line] and distance / lane_width_m < n_lanes:
                away = int(distance / lane_width_m)
                tentative[t, n_lanes - 1 - away if d > 0 else away] += bonus_value
                total += bonus_value
        if total == 0.0:
            for lane in range(n_lanes):
                tentative[t, lane] = 1.0
            total = float(n_lanes)
        scale = 1.0 / (total + n_lanes * tentative_noise)
        for lane in range(n_lanes):
            tentative[t, lane] = (tentative[t, lane] + tentative_noise) * scale
        s = reliability / (max_lri * (n_lanes + 1)) - wor_noise
        if s < 0.0:
            s = wor_noise
        elif s >= 1.0:
            s = 1.0 - wor_noise
        if ignore_frames_without_line and not has_line:
            s = 0.5
        wor[t, 0] = s
        wor[t, 1] = 1.0 - s
