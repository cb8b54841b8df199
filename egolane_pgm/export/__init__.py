"""A result for viewers: an MCAP file of messages, and a video of its pictures."""

from __future__ import annotations

import pandas as pd

from egolane_pgm.result import Result
from egolane_pgm.types import InputError
from egolane_pgm.views.frames import frames_between


def chosen_frames(result: Result, frames: tuple[int, int] | None) -> pd.DataFrame:
    """The frames of a result of one drive.

    - frames: first and last frame id; all by default.

    Raises InputError for several drives, and for a range without frames.
    """
    if "drive" in result.frames:
        raise InputError(f"{result.directory or result.name}: has several drives; run one of them")
    return frames_between(result.frames, *(frames or (None, None)))
