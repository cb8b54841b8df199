"""The lines of one frame as text, laid out as in the paper's Box 1 (`box:box1`)."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import InputError, LineLog


def box_text(log: LineLog, frame_id: int) -> str:
    """One row per line of the frame, `Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m`;
    an LRI that is not known is `--`, as is an offset.

    Raises InputError, with the nearest frame that there is, where the log lacks the frame.
    """
    if not len(log):
        raise InputError(f"{log.source}: has no frames")
    first, last = int(log.frame_id[0]), int(log.frame_id[-1])
    # Whatever number is asked for, it fits an array.
    within = min(max(frame_id, first), last)
    at = int(np.argmin(np.abs(log.frame_id - within)))
    if log.frame_id[at] != frame_id:
        raise InputError(
            f"{log.source}: has no frame {frame_id}; the nearest is {int(log.frame_id[at])}"
            f" (frames {first} to {last})"
        )
    offset, lri = log.offset_m[at], log.lri[at]
    valid, continuous = log.is_valid[at], log.is_continuous[at]
    # The rest is padding.
    is_there = np.isfinite(offset) | np.isfinite(lri) | valid | continuous
    rows = []
    for k in np.flatnonzero(is_there):
        reliability = f"{lri[k]:02.0f}" if np.isfinite(lri[k]) else "--"
        place = f"{offset[k]:+.2f}m" if np.isfinite(offset[k]) else "--"
        rows.append(
            f"Line{k + 1}: isValid = {int(valid[k])}; continuous={int(continuous[k])};"
            f" LRI: {reliability}; offset: {place}"
        )
    return "\n".join(rows) if rows else "no lines"
