"""Clocks: units of times, and frame rates that a recording can have."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import DATED_S, FloatArray, IntArray

#: Units of times: ticks per second.
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}

#: Plausible seconds between two frames: 200 to 0.5 frames per second.
STEP_S = (1 / 200, 2.0)

#: Plausible dates, seconds since 1970: the years 1990 to 2100.
EPOCH_S = (631_152_000.0, 4_102_444_800.0)


def unit_of(number: float, plausible_s: tuple[float, float]) -> str | None:
    """The unit in which a number is a plausible time; None if there is no such unit.

    >>> unit_of(1.79e12, EPOCH_S), unit_of(100, STEP_S)
    ('ms', 'ms')
    """
    low, high = plausible_s
    return next((unit for unit, per in PER_SECOND.items() if low <= number / per <= high), None)


def step_of(frame_id: IntArray, time_s: FloatArray) -> float:
    """The median time between two frames, seconds; NaN for a single frame."""
    if len(frame_id) < 2:
        return np.nan
    return float(np.median(np.diff(time_s) / np.diff(frame_id)))


def clock_warning(
    source: str, frame_id: IntArray, time_s: FloatArray, unit: str | None = None
) -> list[str]:
    """A warning of times whose median step is not plausible, with the cure.

    - frame_id, time_s (T,): seconds. Dates since 1970 are in the right unit.
    - unit: the unit from which they were converted; None if it cannot be set.
    """
    step_s = step_of(frame_id, time_s)
    low, high = STEP_S
    if np.isnan(step_s) or low <= step_s <= high:
        return []
    cure = "; if it is right, set recording.frame_rate"
    right = None
    if unit is not None and time_s[0] < DATED_S:
        right = unit_of(step_s * PER_SECOND[unit], STEP_S)
    if right is not None:
        cure = f"; if the times are in {right}, set `columns: {{time_unit: {right}}}`{cure}"
    return [f"{source}: the median step of its times is {step_s:.4g} s{cure}"]
