"""A result for viewers: an MCAP file of messages, and a video of its pictures."""

from __future__ import annotations

import pandas as pd

from egolane_pgm.result import Result
from egolane_pgm.types import InputError


def chosen_frames(result: Result, frames: tuple[int, int] | None) -> pd.DataFrame:
    """The frames of a result of one drive.

    - frames: first and last frame id; all by default.

    Raises InputError for several drives, and for a range without frames.
    """
    if "drive" in result.frames:
        raise InputError(f"{result.directory or result.name}: has several drives; run one of them")
    if frames is None:
        return result.frames
    ids = result.frames.index
    chosen = result.frames[(ids >= frames[0]) & (ids <= frames[1])]
    if chosen.empty:
        raise InputError(
            f"{result.directory or result.name}: has no frame from {frames[0]} to {frames[1]}; its"
            f" frames are {ids[0]} to {ids[-1]}"
        )
    return chosen
