"""Recognises a camera that has stopped: its pictures repeat."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.vision.camera.picture import Picture

#: A picture that differs from the one before by no more than this, grey levels on the average, is
#: that picture again: the lines stay as they are.
_BELOW = 0.05

#: But after this many repeated pictures in a row the camera is frozen: nothing is detected.
FROZEN_AFTER = 3

#: The step in pixels at which a picture is compared with the one before.
_EVERY = 8


def repeat_counter() -> Callable[[Picture], int]:
    """Makes a function that counts how often in a row a picture has repeated the one before. It
    warns once if the camera is frozen."""
    before: NDArray[np.int16] | None = None
    repeated, has_warned = 0, False

    def count_repeats(picture: Picture) -> int:
        nonlocal before, repeated, has_warned
        sample = picture.image[::_EVERY, ::_EVERY].astype(np.int16)
        is_same = (
            before is not None
            and before.shape == sample.shape
            and float(np.abs(sample - before).mean()) <= _BELOW
        )
        repeated = repeated + 1 if is_same else 0
        before = sample
        if repeated == FROZEN_AFTER and not has_warned:
            has_warned = True
            warnings.warn(
                f"frame {picture.frame_id}: the picture has not changed for"
                f" {repeated} frames (a frozen camera, or a car at rest); nothing counts as"
                " detected until it does",
                UserWarning,
                stacklevel=2,
            )
        return repeated

    return count_repeats
