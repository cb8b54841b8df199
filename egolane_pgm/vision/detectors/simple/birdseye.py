"""The bird's-eye view: the road as a calibrated camera would show it from above (first step of the
paper's section `section:simple-line-detector`).

Row 0 is the far edge and column 0 the left edge. Pixels have one size along the road and another
across it, because the camera resolves the road finely to the side and coarsely ahead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import BoolArray, FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera, is_shown, road_seen
from egolane_pgm.vision.camera.picture import Image, as_image, check_size, rectangle

#: The smallest share of a view that must be in the picture.
_LEAST_SHARE = 0.1

#: Number of views for other pitches that are cached.
VIEWS = 24


@dataclass(frozen=True)
class BirdsEye:
    """A bird's-eye view of R rows and C columns.

    - region: from and to metres ahead, from and to metres to the right
    - x_m: (R,) metres ahead of each row, decreasing
    - y_m: (C,) metres to the right of each column
    - along_m, across_m: size of a pixel, metres
    - valid: (R, C) pixels in the picture, outside the camera's `ignore` rectangles
    - map_uv: pixel of the picture for each pixel, in the form that cv2.remap takes
    """

    camera: Camera
    region: tuple[float, float, float, float]
    x_m: FloatArray
    y_m: FloatArray
    along_m: float
    across_m: float
    valid: BoolArray
    map_uv: tuple[NDArray[np.int16], NDArray[np.uint16]]


def make_view(
    camera: Camera,
    x_min: float,
    x_max: float,
    y_min: float,
    y_max: float,
    along_m: float = 0.2,
    across_m: float = 0.05,
) -> BirdsEye:
    """Make the view of a region of the road, metres ahead and to the right.

    along_m, across_m: size of a pixel, metres.

    Raises InputError if the region is empty or not in the picture.
    """
    if not (0 < x_min < x_max and y_min < y_max and along_m > 0 and across_m > 0):
        raise InputError(
            f"bird's-eye view: {x_min} to {x_max} m ahead and {y_min} to {y_max} m to the right"
            " is not a region in front of the camera"
        )
    n_rows = max(round((x_max - x_min) / along_m), 1)
    n_columns = max(round((y_max - y_min) / across_m), 1)
    x_m = x_max - (np.arange(n_rows, dtype=np.float64) + 0.5) * along_m
    y_m = y_min + (np.arange(n_columns, dtype=np.float64) + 0.5) * across_m
    u, v = road_seen(camera, x_m[:, None], y_m)
    with np.errstate(invalid="ignore"):
        valid = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    valid &= is_shown(camera, u, v)
    if valid.mean() < _LEAST_SHARE:
        raise InputError(
            f"camera: only {100 * valid.mean():.0f} % of the road from {x_min:g} to {x_max:g} m"
            f" ahead is in the picture (pitch_deg {camera.pitch_deg:g}, height_m"
            f" {camera.height_m:g}); calibrate it again or choose another region"
        )
    outside = np.float32(-10)
    map_uv, fractions = cv2.convertMaps(
        np.where(valid, u, outside).astype(np.float32),
        np.where(valid, v, outside).astype(np.float32),
        cv2.CV_16SC2,
    )
    maps = (map_uv.astype(np.int16, copy=False), fractions.astype(np.uint16, copy=False))
    region = (x_min, x_max, y_min, y_max)
    return BirdsEye(camera, region, x_m, y_m, along_m, across_m, valid, maps)


def turned_up(view: BirdsEye) -> Callable[[float], BirdsEye]:
    """Make a function that returns the same view for a camera that is pitched up by some degrees.

    Its last views are cached, because a new one takes longer than a picture: use few different
    pitches. It raises InputError as `make_view` does.
    """

    @lru_cache(maxsize=VIEWS)
    def turned(more_deg: float) -> BirdsEye:
        if not more_deg:
            return view
        camera = replace(view.camera, pitch_deg=view.camera.pitch_deg + more_deg)
        return make_view(camera, *view.region, view.along_m, view.across_m)

    return turned


def look(view: BirdsEye, image: Image) -> Image:
    """Resample a picture, (H, W, 3) or (H, W), from above, (R, C, 3) or (R, C); 0 outside the
    picture.

    Raises InputError for a picture of another size than the calibration.
    """
    check_size(image, view.camera.width, view.camera.height)
    return as_image(
        cv2.remap(image, *view.map_uv, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    )


def lit_and_seen(view: BirdsEye, above: Image, patch: int, across: int) -> tuple[Image, Image]:
    """Mark pixels of a one-colour view (R, C) with 1, else 0: outside black parts of the picture (a
    covered lens, a blanked half), and with road in the view on both sides, (R, C) each.

    - patch: side of the largest dark spot that is not a black part, pixels
    - across: width of the strip that must be in the view, pixels
    """
    spot = rectangle(patch, patch)
    lit = cv2.morphologyEx((above > 0).astype(np.uint8), cv2.MORPH_CLOSE, spot)
    lit[~view.valid] = 0
    strip = rectangle(1, across)
    seen = cv2.erode(lit, strip, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return as_image(lit), as_image(seen)
