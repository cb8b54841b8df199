"""Estimates from a recording what a detector's flags and LRI mean (its habits), because not every
detector uses them as the paper's detectors do.

In the paper the LRI counts detections in the last ten frames. Here the `FULL_SHARE` quantile of the
valid lines' LRI is taken for that of a well tracked line, and scaled to 10. An LRI that is the same
on all lines counts as unknown. Without LRI, a line that repeats its offset to the last digit counts
as held, unless offsets have so few digits that they repeat by chance.

The flag `valid` or `continuous` is ignored if hardly any line has it, or (continuous) nearly every
one. Then all lines are valid, or none is continuous.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: The LRI of a well tracked line, on the paper's scale.
FULL_LRI = 10.0

#: The quantile of the valid lines' LRI that counts as that of a well tracked line. Some detectors
#: now and then report larger numbers, from uninitialised memory.
FULL_SHARE = 0.95

#: The shares of lines with a flag between which the flag is used. In the paper's recordings at
#: least two thirds of the lines are valid, and of these a fifth or none are continuous.
LEAST_VALID, LEAST_CONTINUOUS, MOST_CONTINUOUS = 0.1, 0.01, 0.9

#: The classes of lines: 0 valid and continuous; 1 valid with LRI >= STRONG_LRI; 2 valid with a
#: lower LRI; 3 not valid with LRI >= LEAST_LRI.
N_CLASSES = 4
STRONG_LRI, LEAST_LRI = 6.0, 3.0

#: An offset nearer to 0 than this is a placeholder of a detector that has not measured yet.
PLACEHOLDER_M = 1e-6

#: The least share of distinct values for offsets that do not repeat by chance.
LEAST_DISTINCT = 0.5

#: How many lines' LRI and offsets are kept; a detector does not change its scale.
ENOUGH_LINES = 10_000


Columns = tuple[FloatArray, BoolArray, BoolArray, FloatArray]


@dataclass(frozen=True)
class LineCounts:
    """Counts over the lines of some frames.

    - placed: lines with an offset
    - valid, continuous, both: how many of these have one flag, the other, and both
    - lri_valid, lri_other: the known LRI of valid lines, and of the others
    - offset_m: the offsets
    """

    placed: int
    valid: int
    continuous: int
    both: int
    lri_valid: FloatArray
    lri_other: FloatArray
    offset_m: FloatArray


@dataclass(frozen=True)
class Habits:
    """How a detector uses its flags and LRI.

    - full_lri: the LRI of a well tracked line; NaN if the LRI is not used
    - says_valid, says_continuous: whether the flag is used
    - repeats_are_held: whether a line that repeats its offset was not measured, whatever its LRI
    - notes: what is unusual, one line each
    """

    full_lri: float
    says_valid: bool
    says_continuous: bool
    repeats_are_held: bool = False
    notes: tuple[str, ...] = ()


def is_placed(offset_m: FloatArray) -> BoolArray:
    """Whether there is a line whose offset is no placeholder, of the shape of the offsets."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(offset_m) & (np.abs(offset_m) > PLACEHOLDER_M))


def columns(log: LineLog) -> Columns:
    """The lines of a log, (N,) each: offsets, whether valid, whether continuous, and LRI. These are
    copies: a caller may use its arrays again for the next frame."""
    return (
        log.offset_m.flatten(),
        log.is_valid.flatten(),
        log.is_continuous.flatten(),
        log.lri.flatten(),
    )


def count_lines(logs: Sequence[Columns]) -> LineCounts:
    """Counts the lines of one or several logs."""
    offset_m, is_valid, is_continuous, lri = (
        np.concatenate([log[k] for log in logs]) for k in range(4)
    )
    placed = is_placed(offset_m)
    valid, continuous = placed & is_valid, placed & is_continuous
    known = np.isfinite(lri)
    return LineCounts(
        int(placed.sum()),
        int(valid.sum()),
        int(continuous.sum()),
        int((valid & continuous).sum()),
        lri[valid & known],
        lri[placed & ~valid & known],
        offset_m[placed][:ENOUGH_LINES],
    )


def added(counts: Sequence[LineCounts]) -> LineCounts:
    """Adds counts; the LRI and offsets are those of the first `ENOUGH_LINES` lines."""
    remembered = [
        np.concatenate([getattr(t, name) for t in counts])[:ENOUGH_LINES]
        for name in ("lri_valid", "lri_other", "offset_m")
    ]
    placed, valid, continuous, both = (
        sum(getattr(t, name) for t in counts) for name in ("placed", "valid", "continuous", "both")
    )
    return LineCounts(placed, valid, continuous, both, *remembered)


def habits_of(seen: LineCounts, source: str) -> Habits:
    """Estimates the habits of the detector that reported these lines. source: for the notes."""
    notes = []
    says_valid = seen.valid >= LEAST_VALID * seen.placed
    if not says_valid:
        notes.append(
            f"{source}: only {seen.valid} of {seen.placed} lines are valid; the flag is taken to"
            " say nothing, all lines count"
        )
    flagged = seen.both if says_valid else seen.continuous
    among = seen.valid if says_valid else seen.placed
    is_used = LEAST_CONTINUOUS * among <= flagged <= MOST_CONTINUOUS * among
    says_continuous = is_used or not flagged
    if not says_continuous:
        notes.append(
            f"{source}: {flagged} of {among} lines are continuous; the flag is taken to say nothing"
        )
    lri = seen.lri_valid if says_valid else np.concatenate([seen.lri_valid, seen.lri_other])
    full_lri = _full(lri, np.concatenate([seen.lri_valid, seen.lri_other]))
    if lri.size and math.isnan(full_lri):
        notes.append(f"{source}: the LRI says nothing ({lri[0]:g} nearly everywhere); not used")
    elif lri.size and not 0.75 < full_lri / FULL_LRI < 1.35:
        notes.append(
            f"{source}: the LRI of well tracked lines is {full_lri:g}, not {FULL_LRI:g}; LRIs are"
            " read on that scale"
        )
    offsets = seen.offset_m
    is_fine = len(np.unique(offsets)) >= LEAST_DISTINCT * len(offsets) > 0
    repeats_are_held = is_fine and math.isnan(full_lri)
    return Habits(full_lri, says_valid, says_continuous, repeats_are_held, tuple(notes))


def _full(lri: FloatArray, every: FloatArray) -> float:
    """The LRI of a well tracked line. NaN if there is no LRI, if it is the same on all lines, or if
    it is not positive."""
    if lri.size == 0 or (every == every[0]).all():
        return math.nan
    rank = min(lri.size - 1, int(FULL_SHARE * lri.size))
    full = float(np.partition(lri, rank)[rank])
    return full if full > 0 else math.nan


def translated(log: LineLog, detector: Habits) -> LineLog:
    """The log as the paper's detectors would have written it: an LRI of 0 to 10 or unknown, and
    flags that are used."""
    changes: dict[str, Any] = {}
    if math.isnan(detector.full_lri):
        changes["lri"] = np.full(log.lri.shape, np.nan)
    elif detector.full_lri != FULL_LRI:
        # After rounding, six tenths of a scale are exactly 6.
        with np.errstate(over="ignore"):
            changes["lri"] = np.round(log.lri * (FULL_LRI / detector.full_lri), 9)
    if not detector.says_valid:
        changes["is_valid"] = is_placed(log.offset_m)
    if not detector.says_continuous and log.is_continuous.any():
        changes["is_continuous"] = np.zeros(log.is_continuous.shape, dtype=bool)
    return replace(log, **changes) if changes else log


def translated_recording(log: LineLog, *, say: bool = True) -> tuple[LineLog, Habits]:
    """A whole recording as the paper's detectors would have written it, with the habits found.

    say: whether warnings report what is unusual.
    """
    detector = habits_of(count_lines([columns(log)]), log.source)
    if say:
        for note in detector.notes:
            warnings.warn(note, UserWarning, stacklevel=2)
    return translated(log, detector), detector


def line_classes(log: LineLog) -> tuple[IntArray, BoolArray]:
    """The class of each line, (T, L), -1 where there is none; and whether its place is reliable,
    (T, L). With an unknown LRI, a valid line counts as reliable and any other as tracked."""
    kind = np.empty(log.offset_m.shape, dtype=np.int64)
    is_strong = np.empty(kind.shape, dtype=bool)
    kernels.classify(
        log.offset_m,
        log.is_valid,
        log.is_continuous,
        log.lri,
        STRONG_LRI,
        LEAST_LRI,
        PLACEHOLDER_M,
        kind,
        is_strong,
    )
    return kind, is_strong
