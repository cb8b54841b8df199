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
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: The LRI of a well tracked line, on the paper's scale.
FULL_LRI = 10.0

#: The quantile of the valid lines' LRI that counts as well tracked. Some detectors
#: now and then report larger numbers, from uninitialised memory.
FULL_SHARE = 0.95

#: The shares of lines with a flag between which the flag is used. In the paper's recordings at
#: least two thirds of the lines are valid, and at most a fifth of these are continuous.
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
class FlagSemantics:
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
    """Return whether each offset is a line, not padding or a placeholder."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(offset_m) & (np.abs(offset_m) > PLACEHOLDER_M))


def columns(log: LineLog) -> Columns:
    """Return copies of offsets, valid flags, continuous flags and LRI of all lines, (N,) each."""
    return (
        log.offset_m.flatten(),
        log.is_valid.flatten(),
        log.is_continuous.flatten(),
        log.lri.flatten(),
    )


def count_lines(logs: Sequence[Columns]) -> LineCounts:
    """Count the lines of one or several logs."""
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
    """Add counts; keep the LRI and offsets of the first `ENOUGH_LINES` lines."""
    remembered = [
        np.concatenate([getattr(t, name) for t in counts])[:ENOUGH_LINES]
        for name in ("lri_valid", "lri_other", "offset_m")
    ]
    placed, valid, continuous, both = (
        sum(getattr(t, name) for t in counts) for name in ("placed", "valid", "continuous", "both")
    )
    return LineCounts(placed, valid, continuous, both, *remembered)


def flag_semantics_of(seen: LineCounts, source: str) -> FlagSemantics:
    """Estimate the flag semantics of the detector of these lines. source: for the notes."""
    notes = []
    uses_valid = seen.valid >= LEAST_VALID * seen.placed
    if not uses_valid:
        notes.append(
            f"{source}: only {seen.valid} of {seen.placed} lines are valid; the flag is"
            " ignored, all lines count"
        )
    flagged = seen.both if uses_valid else seen.continuous
    among = seen.valid if uses_valid else seen.placed
    is_used = LEAST_CONTINUOUS * among <= flagged <= MOST_CONTINUOUS * among
    uses_continuous = is_used or not flagged
    if not uses_continuous:
        notes.append(f"{source}: {flagged} of {among} lines are continuous; the flag is ignored")
    lri = seen.lri_valid if uses_valid else np.concatenate([seen.lri_valid, seen.lri_other])
    full_lri = _full(lri, np.concatenate([seen.lri_valid, seen.lri_other]))
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


def translated_recording(log: LineLog, *, say: bool = True) -> tuple[LineLog, FlagSemantics]:
    """Return a whole recording on the paper's scale (`translated`), and its flag semantics.

    say: True to warn of unusual semantics.
    """
    detector = flag_semantics_of(count_lines([columns(log)]), log.source)
    if say:
        for note in detector.notes:
            warnings.warn(note, UserWarning, stacklevel=2)
    return translated(log, detector), detector


def line_classes(log: LineLog) -> tuple[IntArray, BoolArray]:
    """Return the class of each line, -1 in padding, and whether its place is reliable; (T, L) each.

    With an unknown LRI, a valid line counts as reliable and any other as tracked.
    """
    kind = np.empty(log.offset_m.shape, dtype=np.int64)
    is_strong = np.empty(kind.shape, dtype=bool)
    classify(
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
    """Fill kind and is_strong (T, L), see `line_classes`; an unknown LRI counts as the highest."""
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
