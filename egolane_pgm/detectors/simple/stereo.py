"""What the second camera adds: the plane of the road, and what stands on it (paper.tex, section
`section:simple-line-detector`).

The right picture is first moved by the disparities of the calibrated road, so that a flat road has
the same disparity everywhere: matchers prefer surfaces that face the camera, and follow a road that
runs away from it only with a lag. What is then found is how much nearer than the road things are.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.camera.model import Camera, image_to_road
from egolane_pgm.camera.picture import Image, Picture
from egolane_pgm.detectors.simple import matchers as matchers
from egolane_pgm.detectors.simple import plane as planes
from egolane_pgm.detectors.simple.birdseye import BirdsEye, make_view
from egolane_pgm.detectors.simple.finder import OnRoad
from egolane_pgm.detectors.simple.matchers import Match
from egolane_pgm.detectors.simple.plane import Plane
from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, InputError

PARAMETERS = (
    *matchers.PARAMETERS,
    Parameter(
        "match_scale",
        "integer",
        2,
        "pictures are made so many times smaller to match",
        lowest=1,
        highest=100,
    ),
    Parameter(
        "nearest_m", "positive", 3.2, "nothing nearer to the camera is matched, metres", lowest=0.1
    ),
    Parameter(
        "edge_px",
        "integer",
        8,
        "so near to where the right picture ends, pixels as matched, nothing is matched well",
    ),
    *planes.PARAMETERS,
    Parameter(
        "off_plane_m", "positive", 0.25, "what is so far above or below the plane is no road"
    ),
    Parameter(
        "off_plane_px",
        "positive",
        1.0,
        "and whose disparity differs from the plane's by so many pixels as matched",
    ),
    Parameter(
        "off_plane_grow",
        "integer",
        2,
        "so many pixels (as matched) around it are no road either",
        highest=1000,
    ),
    Parameter(
        "pitch_from",
        "choice",
        "plane",
        "the camera's pitch in a frame: of the fitted plane where that is sure, or calibrated",
        choices=("plane", "calibration"),
    ),
    Parameter(
        "pitch_step_deg",
        "positive",
        0.1,
        "steps in which the pitch is corrected, degrees",
        lowest=0.001,
    ),
    Parameter(
        "unsure_after",
        "integer",
        20,
        "frames running without a sure plane before a warning",
        lowest=1,
    ),
)

#: Views for other pitches that are kept.
_VIEWS = 24

#: Frames without a sure plane in which it is tried whether left and right are swapped.
_SWAP_TRIALS = 5


@dataclass(frozen=True)
class Pair:
    """How pairs of pictures are matched: H x W pixels, those of the rows from `top` on, `scale`
    times smaller.

    road (3,): the calibrated plane. u, v (H, W): where in the picture each pixel's middle is.
    looked (H, W): the road is there, and the right picture shows it. points (N,): flat indices of
    those that the plane is fitted to. below_px: disparities of so much less than the road's can be
    found; n_disparities: in all. edge_px: what the right picture must show beyond a match, pixels
    of the full picture. warp (2, 3): moves the right picture's rows by the plane.
    """

    camera: Camera
    scale: int
    top: int
    road: FloatArray
    u: FloatArray
    v: FloatArray
    looked: BoolArray
    points: NDArray[np.int64]
    below_px: int
    n_disparities: int
    edge_px: int
    warp: FloatArray


def on_road(camera: Camera, parameters: Parameters) -> Callable[[BirdsEye], OnRoad]:
    """For a view, the function from a picture of both cameras to the view of it (its pitch that of
    the fitted plane) and which pixels (R, C) of this lie on the plane.

    Raises InputError for a camera that has no second one or is not rectified, and for a matcher
    that there is none of.
    """
    if camera.baseline_m is None:
        raise InputError(
            "baseline_m: is missing; a stereo detector needs to know how far the second camera is"
            " to the right of the first, metres"
        )
    if any(camera.distortion):
        raise InputError(
            "distortion: a stereo pair must be rectified, and then has none: rectify the pictures"
            " and set all five numbers to 0"
        )
    match = matchers.find_matcher(parameters, "matcher")
    pair = make_pair(camera, parameters)

    def for_view(view: BirdsEye) -> OnRoad:
        @lru_cache(maxsize=_VIEWS)
        def pitched(steps: int) -> tuple[BirdsEye, NDArray[np.int64]]:
            seen = _pitched(view, steps * number(parameters, "pitch_step_deg"))
            return seen, _pixels(pair, seen)

        watch = _watch(pair, match, parameters)

        def look(picture: Picture) -> tuple[BirdsEye, BoolArray]:
            left, right = reduced(pair, picture)
            disparity = disparities(pair, match, left, right)
            plane = find_plane(pair, disparity, parameters)
            watch(picture.frame_id, plane, left, right)
            steps = 0
            if plane.is_sure and parameters["pitch_from"] == "plane":
                away = float(planes.pose(camera, plane.abc)[1]) - camera.pitch_deg
                steps = round(away / number(parameters, "pitch_step_deg"))
            seen, pixels = pitched(steps)
            return seen, ~off_plane(pair, disparity, plane, parameters).ravel()[pixels]

        return look

    return for_view


def make_pair(camera: Camera, parameters: Parameters) -> Pair:
    """How this camera's pairs are matched.

    Raises InputError where the pictures would be too small for it.
    """
    scale = int(number(parameters, "match_scale"))
    road = planes.ground_plane(camera)
    top = _first_row(camera, parameters)
    edge = scale * int(number(parameters, "edge_px"))
    height, width = (camera.height - top) // scale, camera.width // scale
    if height < 16 or width < 64:
        raise InputError(
            f"match_scale: {scale} leaves {width}x{height} pixels of the road to match; make it"
            " smaller"
        )
    half = (scale - 1) / 2
    u, v = np.meshgrid(np.arange(width) * scale + half, np.arange(height) * scale + half + top)
    flat = planes.disparity_at(road, u, v)
    looked = _is_road(camera, u, v, parameters) & (u >= flat + edge)
    for left, above, right, bottom in camera.ignore:
        looked &= ~((u >= left) & (u < right) & (v >= above) & (v < bottom))
    every = max(math.ceil(math.sqrt(looked.sum() / planes.MOST_POINTS)), 1)
    grid = np.zeros_like(looked)
    grid[::every, ::every] = True
    assert camera.baseline_m is not None
    swing = math.radians(number(parameters, "most_pitch_deg"))
    full = camera.fx * camera.baseline_m
    below = math.ceil(swing * full / camera.height_m / scale) + 2
    nearest = full / number(parameters, "nearest_m") - max(float(flat.min()), 0.0)
    n_disparities = 16 * math.ceil((below + max(nearest / scale, 1)) / 16)
    if n_disparities >= width:
        raise InputError(
            f"nearest_m: what is {number(parameters, 'nearest_m'):g} m away is"
            f" {n_disparities * scale} pixels apart in the two pictures, which are"
            f" {camera.width} wide; look less near (or is baseline_m wrong?)"
        )
    a, b, c = road
    warp = np.array([[1 - a, -b, below - (c + a * half + b * (half + top)) / scale], [0, 1, 0]])
    points = np.flatnonzero(looked & grid)
    return Pair(camera, scale, top, road, u, v, looked, points, below, n_disparities, edge, warp)


def _is_road(camera: Camera, u: FloatArray, v: FloatArray, parameters: Parameters) -> BoolArray:
    """Whether pixels u, v show the road that lines are looked for on."""
    x, y = image_to_road(camera, u, v)
    with np.errstate(invalid="ignore"):
        is_road: BoolArray = (x < number(parameters, "x_max_m")) & (
            np.abs(y) <= number(parameters, "side_m")
        )
    return is_road


def _first_row(camera: Camera, parameters: Parameters) -> int:
    """The first row that may show that road, the camera pitching as much as it can."""
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(0.0, camera.height, 4.0))
    rows = np.flatnonzero(_is_road(camera, u, v, parameters).any(axis=1)) * 4
    slack = math.tan(math.radians(number(parameters, "most_pitch_deg"))) * camera.fy
    return max(int((rows[0] if len(rows) else 0) - slack), 0)


def reduced(pair: Pair, picture: Picture) -> tuple[Image, Image]:
    """Both pictures, grey and as small as they are matched, (H, W) each.

    Raises InputError where one is missing or has another size.
    """
    if picture.right is None:
        raise InputError("the picture of the second camera is missing")
    size = pair.camera.height, pair.camera.width
    for name, image in (("left", picture.image), ("right", picture.right)):
        if image.shape[:2] != size:
            raise InputError(
                f"the {name} picture has {image.shape[1]}x{image.shape[0]} pixels, but"
                f" the camera was calibrated for {size[1]}x{size[0]}"
            )
    return _small(pair, picture.image), _small(pair, picture.right)


def _small(pair: Pair, image: Image) -> Image:
    height, width = pair.u.shape
    cut = image[pair.top : pair.top + height * pair.scale, : width * pair.scale]
    grey = cut if cut.ndim == 2 else cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)


def disparities(pair: Pair, match: Match, left: Image, right: Image) -> FloatArray:
    """(H, W): disparity of each pixel of the small left picture, in pixels of the full one; NaN
    where there is none, or it is of what the right picture does not show."""
    height, width = pair.u.shape
    moved: Image = cv2.warpAffine(
        right,
        pair.warp,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.uint8, copy=False)
    # Matchers leave out the first columns; here these have a match, so the pictures are widened.
    more = pair.n_disparities
    wide = [np.pad(image, ((0, 0), (more, 0)), mode="edge") for image in (left, moved)]
    found = match(wide[0], wide[1], more)[:, more:]
    with np.errstate(invalid="ignore"):
        found = np.where((found >= 0) & (found < pair.n_disparities), found, np.nan)
    flat = planes.disparity_at(pair.road, pair.u, pair.v)
    disparity: FloatArray = pair.scale * (found.astype(np.float64) - pair.below_px) + flat
    with np.errstate(invalid="ignore"):
        disparity[pair.u - np.maximum(disparity, flat) < pair.edge_px] = np.nan
    return disparity


def find_plane(pair: Pair, disparity: FloatArray, parameters: Parameters) -> Plane:
    """The road's plane in disparities (H, W)."""
    points = pair.points[np.isfinite(disparity.ravel()[pair.points])]
    u, v, d = (a.ravel()[points] for a in (pair.u, pair.v, disparity))
    tolerance = pair.scale * number(parameters, "plane_px")
    plane = planes.fit_plane(pair.camera, u, v, d, tolerance, parameters)
    share = plane.share * len(points) / max(len(pair.points), 1)
    return replace(plane, share=share)


def off_plane(pair: Pair, disparity: FloatArray, plane: Plane, parameters: Parameters) -> BoolArray:
    """(H, W): what is not on the plane. What has no disparity counts as on it; where the plane is
    not sure, so does what would be on it if the camera pitched as much as it can."""
    flat = planes.disparity_at(plane.abc, pair.u, pair.v)
    least_px = number(parameters, "off_plane_px") + (0 if plane.is_sure else pair.below_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        height = pair.camera.height_m * (1 - flat / disparity)
        off = np.abs(height) > number(parameters, "off_plane_m")
        off &= np.abs(disparity - flat) > pair.scale * least_px
    grow = 2 * int(number(parameters, "off_plane_grow")) + 1
    grown = cv2.dilate(off.astype(np.uint8), np.ones((grow, grow), dtype=np.uint8))
    is_off: BoolArray = grown > 0
    return is_off


def _watch(
    pair: Pair, match: Match, parameters: Parameters
) -> Callable[[int, Plane, Image, Image], None]:
    """What speaks up where the plane is not sure: InputError where the two pictures are swapped,
    one warning where it stays unknown."""
    ever_sure, has_warned, running = False, False, 0

    def watch(frame_id: int, plane: Plane, left: Image, right: Image) -> None:
        nonlocal ever_sure, has_warned, running
        ever_sure |= plane.is_sure
        running = 0 if plane.is_sure else running + 1
        if running and not ever_sure and running <= _SWAP_TRIALS:
            swapped = find_plane(pair, disparities(pair, match, right, left), parameters)
            if swapped.is_sure:
                raise InputError(
                    "the pictures of left and right are swapped (the road's disparities are"
                    " negative); give them the other way round"
                )
        if running == int(number(parameters, "unsure_after")) and not has_warned:
            has_warned = True
            warnings.warn(
                f"frame {frame_id}: no road plane found in {running} frames running (do the two"
                " pictures show the same? is the pair rectified, baseline_m right?); the"
                " calibrated plane is used until there is one",
                UserWarning,
                stacklevel=2,
            )

    return watch


def _pitched(view: BirdsEye, more_deg: float) -> BirdsEye:
    """The same view as a camera with so much more pitch sees it."""
    if not more_deg:
        return view
    half_x, half_y = view.along_m / 2, view.across_m / 2
    return make_view(
        replace(view.camera, pitch_deg=view.camera.pitch_deg + more_deg),
        float(view.x_m[-1] - half_x),
        float(view.x_m[0] + half_x),
        float(view.y_m[0] - half_y),
        float(view.y_m[-1] + half_y),
        view.along_m,
        view.across_m,
    )


def _pixels(pair: Pair, view: BirdsEye) -> NDArray[np.int64]:
    """(R, C): which pixel of the small picture, as a flat index, a pixel of the view is."""
    height, width = pair.u.shape
    column = np.clip(view.map_uv[0][..., 0] // pair.scale, 0, width - 1).astype(np.int64)
    row = np.clip((view.map_uv[0][..., 1] - pair.top) // pair.scale, 0, height - 1)
    flat: NDArray[np.int64] = row.astype(np.int64) * width + column
    return flat
