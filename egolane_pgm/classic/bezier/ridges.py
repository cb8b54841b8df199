"""The view from above and the narrow bright strips in it (Aly 2008, sections II A and II B)."""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, scaled
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, lit_and_seen, make_view

#: Near edge of the view, metres ahead.
NEAR_M = 4.0

#: Far edge of the view, metres ahead.
FAR_M = 20.0

#: Half-width of the view, metres.
SIDE_M = 9.0

#: Focal length that larger pictures are brought to, pixels.
_FOCAL_PX = 618.8

#: Rows of the view.
_ROWS = 240

#: Columns of the view.
_COLUMNS = 320

#: Length of the smoothing along the road, rows.
_SMOOTH_TAPS = 33

#: Standard deviation of the smoothing along the road, rows.
_SMOOTH_SIGMA = 8.0

#: Reach of the ridge filter across the road to either side, columns.
_RIDGE_REACH = 4

#: Standard deviation of the ridge filter, columns.
_RIDGE_SIGMA = 0.8

#: Weaker ridges than this quantile are 0 (.985 for the two lines of the own lane only).
_LOWER_QUANTILE = 0.975


def smaller(camera: Camera) -> Camera:
    """The camera whose pictures are this one's, made smaller to the focal length of the view; one
    with a shorter focal length stays as it is."""
    factor = camera.fx / _FOCAL_PX
    if factor <= 1:
        return camera
    return scaled(camera, round(camera.width / factor), round(camera.height / factor))


def view_for(camera: Camera) -> BirdsEye:
    """The view of a camera's pictures. Raises InputError as `make_view` does."""
    along_m = (FAR_M - NEAR_M) / _ROWS
    across_m = 2 * SIDE_M / _COLUMNS
    return make_view(camera, NEAR_M, FAR_M, -SIDE_M, SIDE_M, along_m, across_m)


def ridges(view: BirdsEye, above: Image) -> FloatArray:
    """The response of each pixel of a view of one colour, (R, C), to a filter for narrow bright
    strips; 0 where it is below a quantile, and where the filter sees the edge of the picture.

    Grey levels count from 0 to 1, less their mean; `ridge_weights` make 1 the largest answer.
    """
    ridge = ridge_weights(np.arange(-_RIDGE_REACH, _RIDGE_REACH + 1) / _RIDGE_SIGMA)
    # The edge of a black part of the picture (a covered lens) is not a strip either.
    lit, seen = lit_and_seen(view, above, len(ridge), len(ridge) + 2)
    if not seen.any():
        return np.zeros(above.shape)
    level = above.astype(np.float32) / 255
    level -= level[seen > 0].mean()
    level[lit == 0] = 0
    along = cv2.getGaussianKernel(_SMOOTH_TAPS, _SMOOTH_SIGMA)
    response = cv2.sepFilter2D(level, cv2.CV_32F, ridge, along).astype(np.float64)
    response[(seen == 0) | (response < 0)] = 0
    response[response < np.quantile(response[seen > 0], _LOWER_QUANTILE)] = 0
    return response


def ridge_weights(x: FloatArray) -> FloatArray:
    """The negative second derivative of a Gaussian at places (..., N), in standard deviations; the
    weights have the sum 0 and their sizes the sum 2."""
    weight = np.exp(-(x**2) / 2) * (1 - x**2)
    weight -= weight.mean(axis=-1, keepdims=True)
    weights: FloatArray = 2 * weight / np.abs(weight).sum(axis=-1, keepdims=True)
    return weights
