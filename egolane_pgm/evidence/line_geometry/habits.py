"""What a detector's flags and numbers mean, told from the recording itself: not every detector
fills them as the paper's do.

LRI: the paper's counts detections in the last ten frames. Whatever its scale, `FULL_SHARE` of the
valid lines' LRI lies at or below what a well tracked line has; that is taken for 10. An LRI that is
the same on all lines says nothing and is taken as unknown. Without LRI, a line that repeats its
offset to the last digit is held, unless offsets have so few digits that they repeat by chance.

Valid, continuous: a flag that hardly any line has, or nearly every one, says nothing; lines are
then all valid, or none continuous.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, LineLog

#: The LRI of a well tracked line, on the paper's scale.
FULL_LRI = 10.0

#: The LRI that so many of the valid lines do not exceed is that of a well tracked one: above it are
#: slips of detectors that now and then report numbers from uninitialised memory.
FULL_SHARE = 0.95

#: A flag means something where the share of lines that have it is between these. Of the paper's
#: recordings' lines two thirds are valid or more, and a fifth of those are continuous, or none.
LEAST_VALID, LEAST_CONTINUOUS, MOST_CONTINUOUS = 0.1, 0.01, 0.9

#: Offsets nearer to 0 are placeholders of detectors that have not measured yet.
PLACEHOLDER_M = 1e-6

#: Of offsets that do not repeat by chance, at least this share is different.
LEAST_DISTINCT = 0.5

#: Lines whose LRI and offset are remembered: a detector does not change its scale.
ENOUGH_LINES = 10_000


@dataclass(frozen=True)
class Tally:
    """What some frames' lines look like. placed: lines that have an offset; valid: those of them;
    continuous, of the placed; both. lri_valid, lri_other: known LRI of valid lines and others.
    offset_m: of the placed ones."""

    placed: int
    valid: int
    continuous: int
    both: int
    lri_valid: FloatArray
    lri_other: FloatArray
    offset_m: FloatArray


@dataclass(frozen=True)
class Habits:
    """What a detector says. full_lri: the LRI of a well tracked line; NaN where LRI says nothing.
    says_valid, says_continuous: whether the flag does. repeats_are_held: a line that repeats its
    offset was not measured, whatever its LRI. notes: what is odd, a line each."""

    full_lri: float
    says_valid: bool
    says_continuous: bool
    repeats_are_held: bool = False
    notes: tuple[str, ...] = ()


def is_placed(log: LineLog) -> BoolArray:
    """(T, L): there is a line, and its offset is no placeholder."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(log.offset_m) & (np.abs(log.offset_m) > PLACEHOLDER_M))


def tally(log: LineLog) -> Tally:
    """The tally of a log."""
    placed = is_placed(log)
    valid, continuous = placed & log.is_valid, placed & log.is_continuous
    known = np.isfinite(log.lri)
    return Tally(
        int(placed.sum()),
        int(valid.sum()),
        int(continuous.sum()),
        int((valid & continuous).sum()),
        log.lri[valid & known],
        log.lri[placed & ~valid & known],
        log.offset_m[placed][:ENOUGH_LINES],
    )


def total(tallies: Sequence[Tally]) -> Tally:
    """Of all of them together, LRI and offset of the first `ENOUGH_LINES` lines."""
    remembered = [
        np.concatenate([getattr(t, name) for t in tallies])[:ENOUGH_LINES]
        for name in ("lri_valid", "lri_other", "offset_m")
    ]
    placed, valid, continuous, both = (
        sum(getattr(t, name) for t in tallies) for name in ("placed", "valid", "continuous", "both")
    )
    return Tally(placed, valid, continuous, both, *remembered)


def habits(seen: Tally, source: str) -> Habits:
    """What the detector that made these lines says."""
    notes = []
    says_valid = seen.valid >= LEAST_VALID * seen.placed
    if not says_valid:
        notes.append(
            f"{source}: only {seen.valid} of {seen.placed} lines are valid; the flag is taken to"
            " say nothing, all lines count"
        )
    flagged = seen.both if says_valid else seen.continuous
    among = seen.valid if says_valid else seen.placed
    is_told = LEAST_CONTINUOUS * among <= flagged <= MOST_CONTINUOUS * among
    says_continuous = is_told or not flagged
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
    """NaN where there is no LRI, it is the same everywhere, or that of most lines is 0 or less."""
    if lri.size == 0 or (every == every[0]).all():
        return math.nan
    rank = min(lri.size - 1, int(FULL_SHARE * lri.size))
    full = float(np.partition(lri, rank)[rank])
    return full if full > 0 else math.nan


def as_usual(log: LineLog, detector: Habits) -> LineLog:
    """The log as the paper's detectors would have written it: LRI 0 to 10 or unknown, flags that
    mean what they say."""
    changes: dict[str, Any] = {}
    if math.isnan(detector.full_lri):
        changes["lri"] = np.full(log.lri.shape, np.nan)
    elif detector.full_lri != FULL_LRI:
        # Rounded: six tenths are six, whatever the scale.
        changes["lri"] = np.round(log.lri * (FULL_LRI / detector.full_lri), 9)
    if not detector.says_valid:
        changes["is_valid"] = is_placed(log)
    if not detector.says_continuous and log.is_continuous.any():
        changes["is_continuous"] = np.zeros(log.is_continuous.shape, dtype=bool)
    return replace(log, **changes) if changes else log


def usual(log: LineLog, *, say: bool = True) -> tuple[LineLog, Habits]:
    """A whole recording as the paper's detectors would have written it, and what was found; says in
    warnings what was odd."""
    detector = habits(tally(log), log.source)
    if say:
        for note in detector.notes:
            warnings.warn(note, UserWarning, stacklevel=2)
    return as_usual(log, detector), detector
