"""The red box: detectors, which take camera pictures and give lines. Each is a file here.

A detector is a module with

- `STEREO`: whether it needs the pictures of two cameras
- `PARAMETERS`: a tuple with a `Parameter` for each of its constants
- `start(camera, parameters) -> step`: prepares for one drive. `step` takes a `Picture` and gives
  its `FrameLines`; it is called for each frame in order and keeps its own tracks.

`runner` runs a detector over the pictures of a drive; `simple` holds the parts that the paper's
detectors share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog
from egolane_pgm.vision.camera.picture import Image as Image
from egolane_pgm.vision.camera.picture import Picture


def powers(x: FloatArray | float) -> FloatArray:
    """What offset, heading, curvature and its rate of a line are multiplied with at a distance of
    x metres (...), (..., 4): shape @ powers(x) is where it lies there."""
    x = np.asarray(x, dtype=np.float64)
    return np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6], axis=-1)


@dataclass(frozen=True)
class FrameLines:
    """The L lines of one frame, sorted left to right.

    - shape: (L, 4) coefficients of the clothoid y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6, metres
      to the right at x metres ahead: offset, heading, curvature and its rate. Straight lines have
      s2 = s3 = 0.
    - is_valid, is_continuous: (L,) bool
    - lri: (L,) the line reliability index, how often the line was detected in the last frames

    Raises InputError for arrays of other shapes or types, for shapes that are not finite or sorted.
    """

    shape: FloatArray
    is_valid: BoolArray
    is_continuous: BoolArray
    lri: FloatArray

    def __post_init__(self) -> None:
        n_lines = len(self.shape)
        needed = {"shape": "iuf", "is_valid": "b", "is_continuous": "b", "lri": "iuf"}
        for name, kinds in needed.items():
            value = getattr(self, name)
            wanted = (n_lines, 4) if name == "shape" else (n_lines,)
            if value.dtype.kind not in kinds or value.shape != wanted:
                kind = "numbers" if "f" in kinds else "True or False"
                raise InputError(f"lines: {name} needs a NumPy array of {kind}, {wanted}")
            if not np.isfinite(value).all():
                raise InputError(f"lines: {name} is not finite")
        if (np.diff(self.offset_m) < 0).any():
            raise InputError("lines: the lines are not sorted left to right")

    @property
    def offset_m(self) -> FloatArray:
        """The lines' offsets, (L,), metres, negative on the left."""
        return self.shape[:, 0]


#: The function that a detector's `start` gives: from the next picture of a drive to its lines.
Step = Callable[[Picture], FrameLines]


def as_log(
    frames: Iterable[tuple[int, FrameLines]], frame_rate: float, source: str = "detector"
) -> LineLog:
    """Packs the lines of a drive, given as pairs of frame id and lines, into a LineLog.

    frame_rate: Hz, from which times follow (frame id over frame rate).
    """
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
