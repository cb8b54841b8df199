"""The red box: detectors, which find lines in camera pictures. Each is a file here.

A detector is a module with

- `STEREO`: whether it needs the pictures of two cameras
- `PARAMETERS`: a tuple with a `Parameter` for each of its constants
- `start(camera, parameters) -> step`: prepares for one drive. `step` takes a `Picture` and returns
  its `FrameLines`; it is called for each frame in order and keeps its tracks.

`runner` runs a detector over the pictures of a drive; `simple` has the parts that the paper's
detectors share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog
from egolane_pgm.vision.camera.picture import Image as Image
from egolane_pgm.vision.camera.picture import Picture


def powers(x: FloatArray | float) -> FloatArray:
    """Return the factors (..., 4) with which shape @ powers(x) is the lateral position of a line at
    x metres (...) ahead."""
    x = np.asarray(x, dtype=np.float64)
    return np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6], axis=-1)


def fit_shape(
    x: FloatArray, y: FloatArray, sd_m: FloatArray | float, usual: Iterable[float]
) -> FloatArray:
    """Find the shape (4,) of the line that is nearest to points by least squares.

    - x, y: (P,) metres ahead and to the right
    - sd_m: standard deviation of a point, metres, or (P,) of each point
    - usual: standard deviations of the first values of the shape around 0, infinite for a value
      that may have any size; the values without one are 0
    """
    precision = 1 / np.array([*usual])
    n = len(precision)
    rows = np.vstack([powers(x)[:, :n] / np.reshape(sd_m, (-1, 1)), np.diag(precision)])
    values = np.append(y / sd_m, np.zeros(n))
    # In units in which the columns are alike.
    unit = np.maximum(np.abs(rows).max(axis=0), 1e-12)
    shape = np.zeros(4)
    shape[:n] = np.linalg.lstsq(rows / unit, values)[0] / unit
    return shape


@dataclass(frozen=True)
class FrameLines:
    """The L lines of one frame, sorted left to right.

    - shape: (L, 4) coefficients of the clothoid y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6, metres
      to the right at x metres ahead: offset, heading, curvature and its rate
    - is_valid, is_continuous: (L,) bool
    - lri: (L,) line reliability index, the number of detections in the last frames

    Raises InputError for arrays of other shapes or types, and for shapes not finite or not sorted.
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
        if (self.lri < 0).any():
            raise InputError("lines: a line's lri is not a count of detections")
        if (np.diff(self.offset_m) < 0).any():
            raise InputError("lines: the lines are not sorted left to right")

    @property
    def offset_m(self) -> FloatArray:
        """The offsets (L,) of the lines, metres, negative on the left."""
        return self.shape[:, 0]


#: From the next picture of a drive to its lines, as a detector's `start` returns it.
Step = Callable[[Picture], FrameLines]


def as_log(
    frames: Iterable[tuple[int, FrameLines]], frame_rate: float, source: str = "detector"
) -> LineLog:
    """Make a LineLog of the lines of a drive, given as pairs of frame id and lines.

    frame_rate: Hz, for the times (frame id over frame rate).
    """
    pairs = list(frames)
    lines = [found for _, found in pairs]
    columns = (
        np.concatenate([[], *(getattr(found, name) for found in lines)])
        for name in ("offset_m", "is_valid", "is_continuous", "lri")
    )
    ids = np.array([number for number, _ in pairs], np.int64)
    row = np.repeat(np.arange(len(lines)), [len(found.lri) for found in lines])
    return LineLog.from_rows(ids, frame_rate, row, *columns, source=source)
