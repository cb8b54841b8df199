"""Between the picture and the road: the rows that are searched, and curves of the picture as lines
on the road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from egolane_pgm.classic.multilane import curves
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera, image_to_road, road_to_image, undistorted
from egolane_pgm.vision.detectors import fit_shape

#: Width of the pictures that the constants in pixels are meant for; they are scaled for others.
WIDTH = 1280

#: Number of rows of such a picture that are searched.
ROWS = 454

#: Least number of rows, of ROWS, that show enough of the road.
_FEWEST_ROWS = 60

#: Least number of rows of any picture.
_FEWEST = 8

#: Width of the narrowest marking where it is small, pixels.
_NARROWEST = 3.0

#: Width of the widest marking where it is small, pixels.
_WIDEST = 15.0

#: The rows of a curve that become a line on the road, t.
_T = np.linspace(-1.0, 1.0, 101)


@dataclass(frozen=True)
class Road:
    """The part of a camera's pictures that is searched.

    - top, bottom: its first row, and the row after its last
    - narrowest, widest: (R,) limits of a marking's width in each of its rows, pixels
    """

    camera: Camera
    top: int
    bottom: int
    narrowest: FloatArray
    widest: FloatArray

    @property
    def scale(self) -> float:
        """Scale of constants in pixels, which are meant for a picture 1280 pixels wide."""
        return self.camera.width / WIDTH

    @property
    def row_scale(self) -> float:
        """Scale of constants that count rows, which are meant for the ROWS of such a picture."""
        return len(self.widest) / ROWS

    @property
    def middle(self) -> float:
        """The row t = 0."""
        return (self.top + self.bottom - 1) / 2

    @property
    def pixels_per_m(self) -> FloatArray:
        """Length of a metre across the road at t = 0, and its change with t, (2,), pixels."""
        sides = np.array([[0.0], [self.camera.width]])
        rows = self.middle + np.array([-self.half / 2, self.half])
        y = image_to_road(self.camera, sides, rows, undistorted=True)[1]
        scale = self.camera.width / (y[1] - y[0])
        slope = (scale[1] - scale[0]) / 1.5
        return np.array([scale[1] - slope, slope])

    @property
    def half(self) -> float:
        """Rows from t = 0 to t = 1."""
        return (self.bottom - 1 - self.top) / 2


def road_of(camera: Camera, reach_m: float, narrowest_m: float, widest_m: float) -> Road:
    """The rows that show the road up to reach_m ahead, and the widths of markings there.

    Raises InputError if they are too few.
    """
    row = float(road_to_image(camera, reach_m, camera.lateral_m)[1])
    top = camera.height if np.isnan(row) else int(np.clip(np.ceil(row), 0, camera.height))
    scale = camera.width / WIDTH
    n_rows = camera.height - top
    if n_rows < max(_FEWEST, _FEWEST_ROWS * scale):
        raise InputError(
            f"camera: only {n_rows} rows of the picture show the road up to {reach_m:g} m ahead;"
            " check its pitch, or give a larger reach_m"
        )
    across = np.array([[0.0], [camera.width - 1.0]])
    y = image_to_road(camera, across, np.arange(top, camera.height))[1]
    pixels_per_m = np.nan_to_num((camera.width - 1) / (y[1] - y[0]))
    return Road(
        camera,
        top,
        camera.height,
        np.maximum(scale * _NARROWEST, narrowest_m * pixels_per_m),
        np.maximum(scale * _WIDEST, widest_m * pixels_per_m),
    )


def flattened(road: Road, v: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return t and the column of points in row v and column u, (N,), without lens distortion."""
    if road.camera.is_distorted:
        u, v = undistorted(road.camera, u, v)
    return (v - road.middle) / road.half, u


def places_of(road: Road, curve: FloatArray) -> FloatArray:
    """Metres to the right, (L,), at which curves (L, 3) cross the middle row."""
    y: FloatArray = image_to_road(road.camera, curve[:, 0], road.middle, undistorted=True)[1]
    return y


def shapes_of(road: Road, curve: FloatArray) -> FloatArray:
    """Fit straight lines and parabolas on the road, (L, 4) with the fields of FrameLines, to the
    part of curves (L, 3) in the picture."""
    shape = np.zeros((len(curve), 4))
    for k, one in enumerate(curve):
        u = curves.value(one, _T)
        x, y = image_to_road(road.camera, u, road.middle + road.half * _T, undistorted=True)
        seen = np.isfinite(x) & (u >= 0) & (u < road.camera.width)
        # Two of a hundred rows: the line is at the picture's edge, and its rest has to do.
        seen = seen if seen.sum() > 10 else np.isfinite(x)
        shape[k] = fit_shape(x[seen], y[seen], 1.0, [np.inf] * (2 if one[2] == 0 else 3))
    return shape
