"""The lines of the paper's Box 1, and how they are printed."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import LineLog

#: The paper's Box 1.
BOX = """\
Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m
Line2: isValid = 0; continuous=0; LRI: 09; offset: -6.47m
Line3: isValid = 1; continuous=0; LRI: 07; offset: -2.15m
Line4: isValid = 0; continuous=1; LRI: 00; offset: +0.99m"""


def box_log() -> LineLog:
    """Frame 1234 is the paper's; 1236 has no line, 1237 has two of which little is known."""
    nan = np.nan
    offset = np.array([[-9.15, -6.47, -2.15, 0.99, nan], [nan] * 5, [nan, 1.5, nan, nan, nan]])
    valid = np.array([[1, 0, 1, 0, 0], [0] * 5, [0, 1, 0, 0, 0]], dtype=bool)
    continuous = np.array([[1, 0, 0, 1, 0], [0] * 5, [0] * 5], dtype=bool)
    lri = np.array([[10, 9, 7, 0, nan], [nan] * 5, [3, nan, nan, nan, nan]])
    frame_id = np.array([1234, 1236, 1237])
    return LineLog(frame_id, frame_id / 10, offset, valid, continuous, lri, source="box.csv")
