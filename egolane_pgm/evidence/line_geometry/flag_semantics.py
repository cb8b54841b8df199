"""Estimate the semantics of a detector's flags and LRI from a recording.

In the paper the LRI counts detections in the last ten frames. Other detectors have other scales, so
the `FULL_SHARE` quantile of the valid lines' LRI is scaled to 10. An LRI that is equal on all lines
counts as unknown. Without LRI, a line that repeats its offset to the last digit counts as held,
unless the offsets have so few digits that they repeat by chance.

The flag `valid` or `continuous` is ignored if hardly any line has it, or (continuous) nearly every
one. Then all lines are valid, or all are not continuous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry.scale import FULL_LRI, PLACEHOLDER_M
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: The quantile of the valid lines' LRI that counts as well tracked. Some detectors
#: now and then report larger numbers, from uninitialised memory.
FULL_SHARE = 0.95

#: The least share of valid lines for the flag to be used: two thirds in the paper's recordings.
LEAST_VALID = 0.1

#: The least and the largest share of continuous lines for the flag to be used: at most a fifth in
#: the paper's recordings.
LEAST_CONTINUOUS = 0.01
MOST_CONTINUOUS = 0.9

#: The least share of distinct values for offsets that do not repeat by chance.
LEAST_DISTINCT = 0.5

#: How many lines' LRI and offsets are kept; a detector does not change its scale.
ENOUGH_LINES = 10_000

#: Offsets, valid flags, continuous flags and LRI of N lines, (N,) each.
Columns = tuple[FloatArray, BoolArray, BoolArray, FloatArray]


class LineCounts(NamedTuple):
    """Counts over the lines of some frames.

    - numbers: (4,) lines with an offset; of these the valid ones, the continuous ones, and both
    - lri_valid, lri_other: the known LRI of valid lines, and of the others
    - offset_m: the offsets
    """

    numbers: IntArray
    lri_valid: FloatArray
    lri_other: FloatArray
    offset_m: FloatArray


NO_LINES = LineCounts(np.zeros(4, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0))


class FlagSemantics(NamedTuple):
    """The semantics of a detector's flags and LRI.

    - full_lri: the LRI of a well tracked line; NaN if the LRI is not used
    - uses_valid, uses_continuous: True if the flag is used
    - repeats_are_held: whether a line that repeats its offset was not measured, for any LRI
    - notes: warnings, one line each
    """

    full_lri: float
    uses_valid: bool
    uses_continuous: bool
    repeats_are_held: bool = False
    notes: tuple[str, ...] = ()


#: The semantics of the paper's detectors.
PAPER = FlagSemantics(FULL_LRI, uses_valid=True, uses_continuous=True)


def is_placed(offset_m: FloatArray) -> BoolArray:
    """Return True for offsets of lines, False for padding and placeholders."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(offset_m) & (np.abs(offset_m) > PLACEHOLDER_M))


def columns(log: LineLog) -> Columns:
    """Return copies of the columns of all lines."""
    return (
        log.offset_m.flatten(),
        log.is_valid.flatten(),
        log.is_continuous.flatten(),
        log.lri.flatten(),
    )


def count_lines(logs: Sequence[Columns]) -> LineCounts:
    """Count the lines of one or several logs."""
    offset_m, is_valid, is_continuous, lri = map(np.concatenate, zip(*logs, strict=True))
    placed = is_placed(offset_m)
    valid = placed & is_valid
    continuous = placed & is_continuous
    known = np.isfinite(lri)
    flags = (placed, valid, continuous, valid & continuous)
    return LineCounts(
        np.array([np.count_nonzero(flag) for flag in flags]),
        lri[valid & known],
        lri[placed & ~valid & known],
        offset_m[placed][:ENOUGH_LINES],
    )


def added(first: LineCounts, second: LineCounts) -> LineCounts:
    """Add counts; keep the LRI and offsets of the first `ENOUGH_LINES` lines."""
    kept = [np.concatenate(pair)[:ENOUGH_LINES] for pair in zip(first[1:], second[1:], strict=True)]
    return LineCounts(first.numbers + second.numbers, *kept)


def flag_semantics_of(seen: LineCounts, source: str) -> FlagSemantics:
    """Estimate the flag semantics of the detector of these lines. source: for the notes."""
    placed, valid, continuous, both = seen.numbers.tolist()
    notes = []
    uses_valid = valid >= LEAST_VALID * placed
    if not uses_valid:
        notes.append(
            f"{source}: only {valid} of {placed} lines are valid; the flag is"
            " ignored, all lines count"
        )
    flagged = both if uses_valid else continuous
    among = valid if uses_valid else placed
    is_used = LEAST_CONTINUOUS * among <= flagged <= MOST_CONTINUOUS * among
    uses_continuous = is_used or not flagged
    if not uses_continuous:
        notes.append(f"{source}: {flagged} of {among} lines are continuous; the flag is ignored")
    every = np.concatenate([seen.lri_valid, seen.lri_other])
    lri = seen.lri_valid if uses_valid else every
    full_lri = _full(lri, every)
    if lri.size and math.isnan(full_lri):
        notes.append(f"{source}: the LRI is {lri[0]:g} nearly everywhere; it is ignored")
    elif lri.size and not 0.75 < full_lri / FULL_LRI < 1.35:
        notes.append(
            f"{source}: the LRI of well tracked lines is {full_lri:g}, not {FULL_LRI:g}; LRIs are"
            " read on that scale"
        )
    offsets = seen.offset_m
    is_fine = len(np.unique(offsets)) >= LEAST_DISTINCT * len(offsets) > 0
    repeats_are_held = is_fine and math.isnan(full_lri)
    return FlagSemantics(full_lri, uses_valid, uses_continuous, repeats_are_held, tuple(notes))


def _full(lri: FloatArray, every: FloatArray) -> float:
    """Return the LRI of a well tracked line; NaN if there is none, or it is constant or <= 0."""
    if lri.size == 0 or (every == every[0]).all():
        return math.nan
    rank = min(lri.size - 1, int(FULL_SHARE * lri.size))
    full = float(np.partition(lri, rank)[rank])
    return full if full > 0 else math.nan


def translated(log: LineLog, detector: FlagSemantics) -> LineLog:
    """Return the log on the scale of the paper's detectors: LRI 0 to 10 or unknown, used flags."""
    changes: dict[str, Any] = {}
    if math.isnan(detector.full_lri):
        changes["lri"] = np.full(log.lri.shape, np.nan)
    elif detector.full_lri != FULL_LRI:
        # After rounding, six tenths of a scale are exactly 6.
        with np.errstate(over="ignore"):
            changes["lri"] = np.round(log.lri * (FULL_LRI / detector.full_lri), 9)
    if not detector.uses_valid:
        changes["is_valid"] = is_placed(log.offset_m)
    if not detector.uses_continuous and log.is_continuous.any():
        changes["is_continuous"] = np.zeros(log.is_continuous.shape, dtype=bool)
    return replace(log, **changes) if changes else log
