"""Select the frames of a recording, fill in missing ones, and warn of oddities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egolane_pgm.recordings.clock import step_of
from egolane_pgm.types import FloatArray, InputError, IntArray, LineLog

#: Valid lines with an offset beyond this, metres, are warned of: no motorway is wider.
ABSURD_OFFSET_M = 100.0

#: Frames on each side of an annotated lane change in which the lines pass under the car.
HALF_CHANGE = 20

#: A longer gap cannot be filled: its ids cannot be frame numbers.
MAX_FILLED = 1_000_000


def select_frames(log: LineLog, first: int | None = None, stop: int | None = None) -> LineLog:
    """Take the frames with first <= frame id < stop; None leaves that side open.

    Raises InputError, with the range of the recording, if no frame is left.
    """
    keep = log.frame_id >= (-np.inf if first is None else first)
    keep &= log.frame_id < (np.inf if stop is None else stop)
    if not keep.any():
        low = "start" if first is None else first
        high = "end" if stop is None else stop
        raise InputError(
            f"{log.source}: no frame from {low} to before {high}; the recording has"
            f" {frame_range(log.frame_id)}"
        )
    return log if keep.all() else log.take(keep)


def fill_missing(log: LineLog, policy: str, frame_rate: float) -> LineLog:
    """Fill in the frame ids that are missing between the first and the last.

    - policy: "skip" leaves them out; "hold" repeats the lines of the frame before; "predict"
      adds frames without lines, flagged `is_missing`, so that a filter only predicts there.
      Covariates keep the value of the frame before.
    - frame_rate: frames per second, for the times of added frames.

    Raises InputError for gaps so large that the ids cannot be frame numbers.
    """
    n_missing = int(np.ptp(log.frame_id)) + 1 - len(log) if len(log) else 0
    if policy == "skip" or n_missing == 0:
        return log
    first = int(log.frame_id[0])
    last = int(log.frame_id[-1])
    if n_missing > MAX_FILLED:
        raise InputError(
            f"{log.source}: missing_frames: {policy} would add {n_missing} frames between"
            f" {first} and {last}; are these ids frame numbers?"
        )
    frame_id = np.arange(first, last + 1)
    before = np.searchsorted(log.frame_id, frame_id, side="right") - 1
    is_new = log.frame_id[before] != frame_id
    new_s = frame_id / frame_rate
    if not np.array_equal(log.time_s, log.frame_id / frame_rate):
        # The recording has time stamps: continue from the frame before.
        new_s = log.time_s[before] + (frame_id - log.frame_id[before]) / frame_rate
    empty = is_new[:, None] & (policy == "predict")
    return replace(
        log,
        frame_id=frame_id,
        time_s=np.where(is_new, new_s, log.time_s[before]),
        offset_m=np.where(empty, np.nan, log.offset_m[before]),
        is_valid=~empty & log.is_valid[before],
        is_continuous=~empty & log.is_continuous[before],
        lri=np.where(empty, np.nan, log.lri[before]),
        is_missing=np.where(is_new, policy == "predict", log.is_missing[before]),
        clip=None if log.clip is None else log.clip[before],
        covariates={name: values[before] for name, values in log.covariates.items()},
    )


def fill_after(last: LineLog | None, log: LineLog, policy: str, frame_rate: float) -> LineLog:
    """Fill in the frames that are missing in a log and before it; see `fill_missing`.

    - last: the frame before the log, if any.

    Raises InputError for frames that do not come after it.
    """
    if last is None:
        return fill_missing(log, policy, frame_rate)
    if log.frame_id[0] <= last.frame_id[0]:
        raise InputError(
            f"{log.source}: frame id {log.frame_id[0]} does not come after {last.frame_id[0]}"
        )
    if policy == "skip":
        return log
    return fill_missing(LineLog.concat([last, log]), policy, frame_rate).take(slice(1, None))


def rate_of(frame_id: IntArray, time_s: FloatArray) -> float | None:
    """Frames per second of T frames, to four digits; None if unknown."""
    step = step_of(frame_id, time_s)
    return float(f"{1 / step:.4g}") if step > 0 else None


def recording_warnings(log: LineLog, n_lanes: int, max_lri: float = 10) -> list[str]:
    """Warn of oddities, one line each: an LRI of a valid line outside 0..max_lri, an absurd offset,
    more valid lines than the n_lanes + 1 of the road, and no valid line at all."""
    kinds = {
        f"valid line(s) have an LRI outside 0..{max_lri:g}": (
            log.is_valid & ((log.lri < 0) | (log.lri > max_lri))
        ),
        f"valid line(s) have an offset beyond {ABSURD_OFFSET_M:g} m": (
            log.is_valid & (np.abs(log.offset_m) > ABSURD_OFFSET_M)
        ),
        f"frame(s) have more valid lines than the {n_lanes + 1} of {n_lanes} lane(s)": (
            log.is_valid.sum(axis=1, keepdims=True) > n_lanes + 1
        ),
    }
    warned = [
        f"{log.source}: {np.count_nonzero(odd)} {what}, first in frame"
        f" {log.frame_id[odd.any(axis=1).argmax()]}"
        for what, odd in kinds.items()
        if odd.any()
    ]
    if len(log) and not log.is_valid.any():
        warned.append(f"{log.source}: not a single valid line in {len(log)} frames")
    return warned


def sign_warning(log: LineLog, true_lane: IntArray) -> list[str]:
    """Warn of lines that move the wrong way at most of the annotated lane changes.

    - log, true_lane (K,): of the same frames.
    """
    to_left = -np.diff(true_lane)
    offset = np.where(log.is_valid, log.offset_m, np.nan)
    agrees = against = 0
    for k in np.flatnonzero(to_left).tolist():
        near = offset[max(0, k - HALF_CHANGE) : k + HALF_CHANGE]
        step = near[1:, None, :] - near[:-1, :, None]
        # A line is the nearest one of the next frame, unless it jumps by more than half a metre.
        nearest = np.nanmin(np.abs(step), axis=(1, 2), initial=0.5)[:, None, None]
        moved = np.nansum(np.where(np.abs(step) == nearest, step, 0)) * np.sign(to_left[k])
        agrees += moved > 1
        against += moved < -1
    if against < 3 or against < 0.8 * (agrees + against):
        return []
    return [
        f"{log.source}: at {against} of {agrees + against} annotated lane changes the lines move as"
        " if the car went the other way; are the offsets positive to the left (`columns:"
        " {left_positive: true}`), or do the lane numbers count from the right?"
    ]


def frame_range(frame_id: IntArray) -> str:
    """The first and the last of some frame ids, for messages."""
    return f"frames {frame_id[0]} to {frame_id[-1]}" if len(frame_id) else "no frames"
