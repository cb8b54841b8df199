"""Camera pictures in, lines out (the red box): one file per detector.

A detector is a module with

- `STEREO`: whether it needs pictures of two cameras;
- `PARAMETERS`: a tuple of `Parameter`, every constant that it has;
- `start(camera, parameters) -> step`: makes what a drive needs once, and gives a function from one
  `Picture` to its `FrameLines`, called frame by frame in order, that keeps its tracks to itself.

Modules whose name starts with `_` are what the detectors share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.camera.picture import Image as Image
from egolane_pgm.camera.picture import Picture
from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog


@dataclass(frozen=True)
class FrameLines:
    """The L lines of one frame, left to right.

    shape (L, 4): y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6, metres to the right at x metres ahead
    (offset, heading, curvature and its rate: a clothoid; straight lines have s2 = s3 = 0).
    is_valid, is_continuous (L,): bool. lri (L,): detections in the last frames.

    Raises InputError for what are no arrays of these shapes and kinds.
    """

    shape: FloatArray
    is_valid: BoolArray
    is_continuous: BoolArray
    lri: FloatArray

    def __post_init__(self) -> None:
        for name, kinds, needed in (
            ("shape", "iuf", "numbers"),
            ("is_valid", "b", "True or False"),
            ("is_continuous", "b", "True or False"),
            ("lri", "iuf", "numbers"),
        ):
            value = getattr(self, name)
            if not isinstance(value, np.ndarray) or value.dtype.kind not in kinds:
                found = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
                raise InputError(f"lines: {name} is {found}, needs a NumPy array of {needed}")
        n_lines = len(self.shape) if self.shape.ndim else 0
        if self.shape.shape != (n_lines, 4):
            raise InputError(f"lines: shape is {self.shape.shape}, needs (L, 4)")
        for name in ("is_valid", "is_continuous", "lri"):
            if getattr(self, name).shape != (n_lines,):
                raise InputError(f"lines: {name} needs one value for each of {n_lines} lines")

    @property
    def offset_m(self) -> FloatArray:
        """(L,): metres, negative left."""
        return self.shape[:, 0]


Step = Callable[[Picture], FrameLines]


def as_log(
    frames: Iterable[tuple[int, FrameLines]], frame_rate: float, source: str = "detector"
) -> LineLog:
    """The lines of a drive, frame by frame, as a LineLog."""
    given = list(frames)
    lines = [found for _, found in given]

    def column(name: str) -> NDArray[Any]:
        return np.concatenate([[], *(getattr(found, name) for found in lines)])

    return LineLog.from_rows(
        np.array([number for number, _ in given], dtype=np.int64),
        frame_rate,
        np.repeat(np.arange(len(lines)), np.array([len(found.lri) for found in lines], dtype=int)),
        column("offset_m"),
        column("is_valid"),
        column("is_continuous"),
        column("lri"),
        source=source,
    )
