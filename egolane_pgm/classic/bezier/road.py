"""From points of splines to lines on the road."""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.detectors import powers

#: How far a point is off its line, metres.
_POINT_SD_M = 0.1

#: Standard deviation of the heading of a road, m/m. A spline is short, and a cubic through it alone
#: would leave the road before it reaches the car.
_HEADING_SD = 0.03

#: Standard deviation of the curvature of a road, 1/m.
_CURVATURE_SD = 1e-3

#: Standard deviation of the curvature's rate, 1/m^2.
_RATE_SD = 3e-5


def shape_of(x: FloatArray, y: FloatArray) -> FloatArray:
    """The line s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6, (4,) as in FrameLines, nearest to points (P,)
    by least squares; all but the offset is kept small."""
    design = powers(x) / _POINT_SD_M
    usual = np.diag([0, 1 / _HEADING_SD, 1 / _CURVATURE_SD, 1 / _RATE_SD])
    rows = np.vstack([design, usual])
    values = np.concatenate([y / _POINT_SD_M, np.zeros(4)])
    # In units in which the four columns are alike.
    unit = np.maximum(np.abs(rows).max(axis=0), 1e-12)
    shape: FloatArray = np.linalg.lstsq(rows / unit, values)[0] / unit
    return shape
