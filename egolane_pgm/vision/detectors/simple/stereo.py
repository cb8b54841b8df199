"""Separates the road from the objects on it, with a second camera (paper, section
`section:simple-line-detector`).

Matchers prefer surfaces that face the camera; they follow a road that runs away from it only with
a lag. So the right picture is first moved by the disparities of the calibrated road. A flat road
then has the same disparity everywhere, and the matcher finds how much nearer than the road objects
are.

A point Z metres away along the optical axis lies f B / Z pixels farther left in the second picture.
On a flat road this disparity is linear in the pixel, d = a u + b v + c, and it is 0 at the horizon
("the ground plane equation" of the paper). Pixels are those of the first picture, rectified and at
full size.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, InputError, problems_in
from egolane_pgm.vision.camera.model import Camera, axes, image_to_road
from egolane_pgm.vision.camera.picture import Image, Picture, check_size
from egolane_pgm.vision.detectors.simple.birdseye import VIEWS, BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.finder import OnRoad

PARAMETERS = (
    Parameter(
        "matcher",
        "choice",
        "sgbm",
        "what finds the disparities: sgbm (semi-global matching, of OpenCV) or elas (Geiger, Roser"
        " and Urtasun 2010; the extra elas)",
        choices=("sgbm", "elas"),
    ),
    Parameter(
        "match_rows",
        "integer",
        4,
        "how many rows of the pictures become one to match; several make the matches of plain"
        " surfaces surer, and they cost less",
        lowest=1,
        highest=100,
    ),
    Parameter("nearest_m", "positive", 4.0, "smallest distance that is matched, metres"),
)

#: The factor by which pictures are made narrower to match, and the least share of the matched
#: points on a sure plane.
_SCALE, _PLANE_SHARE = 2, 0.4

#: The least height of objects above or below the plane, metres.
_OFF_PLANE_M = 0.25

#: The frames in a row without a sure plane before a warning.
_UNSURE_AFTER = 20

#: Takes two small grey pictures (H, W) and the number of disparities that are searched, and gives
#: the disparity of each pixel of the left one, (H, W); negative where it cannot tell.
Match = Callable[[Image, Image, int], FloatArray]

#: Side of the blocks that are compared by `cv2.StereoSGBM`, pixels as matched.
_BLOCK_PX = 5

#: ELAS falls over pictures with fewer rows than about 40.
_ELAS_ROWS = 48

#: The package has no wheel, and its build does not say where NumPy's headers are.
_INSTALL_ELAS = (
    'CPLUS_INCLUDE_PATH=$(python -c "import numpy; print(numpy.get_include())")'
    " pip install 'egolane-pgm[elas]'"
)

#: The largest distance of a disparity from a plane that it lies on, the least difference of an
#: object's disparity from the plane's, the margin around objects that is no road either, and the
#: right picture's edge where nothing is matched well, pixels as matched.
_PLANE_PX, _OFF_PLANE_PX, _GROW_PX, _EDGE_PX = 0.5, 1.0, 2, 8

#: The steps in which the pitch is corrected, degrees.
_PITCH_STEP_DEG = 0.1

#: How many planes through three random points are tried, and the least number of points (of at most
#: MOST_POINTS) on a sure plane.
_TRIALS, _POINTS = 100, 200

#: The largest differences of a plane's pitch and roll (degrees) and of the camera's height (share)
#: from the calibrated ones.
MOST_PITCH_DEG, _MOST_ROLL_DEG, _MOST_HEAVE = 2.5, 1.5, 0.12

#: The most points that a plane is fitted to.
MOST_POINTS = 3000

#: For each round of least squares, how near a point must be to the plane to count, in tolerances.
_ROUNDS = (2.0, 1.5, 1.0, 1.0)


@dataclass(frozen=True)
class Plane:
    """A plane of the road, d = a u + b v + c.

    - abc: (3,) its coefficients; those of the calibrated plane where none is sure
    - share: the share of the points that lie on it
    - is_sure: whether enough points lie on it, and the camera can be in this pose
    """

    abc: FloatArray
    share: float
    is_sure: bool


@dataclass(frozen=True)
class Pair:
    """How the pairs of pictures of one camera are matched: as H x W pixels.

    - rows: height of a small pixel, rows of the full picture; its width is _SCALE
    - top: first row of the full picture that is used
    - flat: (H, W) disparities of the calibrated plane
    - u, v: (H, W) pixel of the full picture at the middle of each small pixel
    - looked: (H, W) whether a pixel shows road, and the right picture shows it as well
    - below_px: how far below the road's disparity the search goes, small pixels
    - n_disparities: number of disparities that are searched
    - warp: (2, 3) affine map that moves the rows of the right picture by the plane
    - match: the matcher
    """

    camera: Camera
    rows: int
    top: int
    flat: FloatArray
    u: FloatArray
    v: FloatArray
    looked: BoolArray
    below_px: int
    n_disparities: int
    warp: FloatArray
    match: Match

    @cached_property
    def points(self) -> NDArray[np.int64]:
        """Flat indices of the small pixels that the plane is fitted to, (N,)."""
        every = max(math.ceil(math.sqrt(self.looked.sum() / MOST_POINTS)), 1)
        grid = np.zeros_like(self.looked)
        grid[::every, ::every] = True
        return np.flatnonzero(self.looked & grid)


def on_road(camera: Camera, parameters: Parameters) -> Callable[[BirdsEye], OnRoad]:
    """Makes the `on_road` of `finder.start`: given a view, it makes a function from a picture of
    both cameras to the view with this frame's pitch and its pixels (R, C) on the road plane.

    Raises InputError for a camera with lens distortion.
    """
    if any(camera.distortion):
        raise InputError(
            "distortion: a stereo pair must be rectified, and then has none: rectify the pictures"
            " and set all five numbers to 0"
        )
    pair = make_pair(camera, parameters)

    def for_view(view: BirdsEye) -> OnRoad:
        turned = turned_up(view)

        @lru_cache(maxsize=VIEWS)
        def pitched(steps: int) -> tuple[BirdsEye, NDArray[np.int64]]:
            seen = turned(steps * _PITCH_STEP_DEG)
            return seen, _pixels(pair, seen)

        watch = _watch()

        def look(picture: Picture) -> tuple[BirdsEye, BoolArray]:
            disparity = disparities(pair, *reduced(pair, picture))
            plane = find_plane(pair, disparity)
            watch(picture.frame_id, plane)
            steps = 0
            if plane.is_sure:
                away = float(pose(camera, plane.abc)[1]) - camera.pitch_deg
                steps = round(away / _PITCH_STEP_DEG)
            seen, pixels = pitched(steps)
            return seen, ~off_plane(pair, disparity, plane).ravel()[pixels]

        return look

    return for_view


def make_pair(camera: Camera, parameters: Parameters) -> Pair:
    """Prepares the matching of a camera's pairs.

    Raises InputError if the pictures would become too small, or `nearest_m` too near for them.
    """
    rows, height_m = int(number(parameters, "match_rows")), camera.height_m
    top, bottom = _rows(camera, parameters)
    height, width = (bottom - top) // rows, camera.width // _SCALE
    least = _ELAS_ROWS if parameters["matcher"] == "elas" else 16
    if height < least or width < 64:
        raise InputError(
            f"match_rows: {rows} leaves {width}x{height} pixels of the road to match, and"
            f" {parameters['matcher']} needs 64x{least}; make it smaller, or take larger pictures"
        )
    half, half_row = (_SCALE - 1) / 2, (rows - 1) / 2
    u, v = np.meshgrid(np.arange(width) * _SCALE + half, np.arange(height) * rows + half_row + top)
    road = ground_plane(camera)
    flat = disparity_at(road, u, v)
    looked = _is_road(camera, u, v, parameters) & (u >= flat + _SCALE * _EDGE_PX)
    for left, above, right, bottom in camera.ignore:
        looked &= ~((u >= left) & (u < right) & (v >= above) & (v < bottom))
    assert camera.baseline_m is not None
    swing = math.radians(MOST_PITCH_DEG)
    full = camera.fx * camera.baseline_m
    below = math.ceil(swing * full / height_m / _SCALE) + 2
    nearest = full / number(parameters, "nearest_m") - max(float(flat.min()), 0.0)
    n_disparities = 16 * math.ceil((below + max(nearest / _SCALE, 1)) / 16)
    if n_disparities >= width:
        raise InputError(
            f"nearest_m: what is so near is {n_disparities * _SCALE} pixels apart in the two"
            f" pictures, which are {camera.width} wide; look less near (or is baseline_m wrong?)"
        )
    a, b, c = road
    first = c + a * half + b * (half_row + top)
    warp = np.array([[1 - a, -b * rows / _SCALE, below - first / _SCALE], [0, 1, 0]])
    match = _elas() if parameters["matcher"] == "elas" else _sgbm
    return Pair(camera, rows, top, flat, u, v, looked, below, n_disparities, warp, match)


def _sgbm(left: Image, right: Image, n_disparities: int) -> FloatArray:
    area = _BLOCK_PX**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=n_disparities,
        blockSize=_BLOCK_PX,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    # OpenCV counts in sixteenths of a pixel.
    return np.asarray(matcher.compute(left, right) / 16)


def _elas() -> Match:
    """The matcher ELAS. Raises InputError if its package is not installed."""
    try:
        from elas import Elas
    except ImportError:
        raise InputError(f"matcher: elas is not installed: {_INSTALL_ELAS}") from None
    kept: list[Image] = []

    def match(left: Image, right: Image, n_disparities: int) -> FloatArray:
        # pyelas never lets go of an array that it was given, so it gets the same two each time.
        if not kept or kept[0].shape != left.shape:
            kept[:] = np.empty_like(left, order="C"), np.empty_like(right, order="C")
        kept[0][:], kept[1][:] = left, right
        matcher = Elas()
        matcher.disp_max = n_disparities - 1
        return np.asarray(matcher.process(*kept)[0], dtype=np.float64)

    return match


def _is_road(camera: Camera, u: FloatArray, v: FloatArray, parameters: Parameters) -> BoolArray:
    """Whether pixels u, v show the region of the road that lines are searched in."""
    x, y = image_to_road(camera, u, v)
    with np.errstate(invalid="ignore"):
        is_road: BoolArray = (x < number(parameters, "x_max_m")) & (
            np.abs(y) <= number(parameters, "side_m")
        )
    return is_road


def _rows(camera: Camera, parameters: Parameters) -> tuple[int, int]:
    """The first row that may show that region at the largest allowed pitch, and one more than the
    last row that may show its part in view."""
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(0.0, camera.height, 4.0))
    x, _ = image_to_road(camera, u, v)
    is_road = _is_road(camera, u, v, parameters)
    rows = np.flatnonzero(is_road.any(axis=1)) * 4
    with np.errstate(invalid="ignore"):
        in_view = np.flatnonzero((is_road & (x >= number(parameters, "x_min_m"))).any(axis=1)) * 4
    slack = math.tan(math.radians(MOST_PITCH_DEG)) * camera.fy
    top = max(int((rows[0] if len(rows) else 0) - slack), 0)
    last = in_view[-1] + 4 + slack if len(in_view) else camera.height
    return top, min(int(last), camera.height)


def reduced(pair: Pair, picture: Picture) -> tuple[Image, Image]:
    """Both pictures in grey, made smaller for the matching, (H, W) each.

    Raises InputError if one is missing or has another size than the calibration.
    """
    if picture.right is None:
        raise InputError("the picture of the second camera is missing")
    for name, image in (("left", picture.image), ("right", picture.right)):
        with problems_in(name):
            check_size(image, pair.camera.width, pair.camera.height)
    return _small(pair, picture.image), _small(pair, picture.right)


def _small(pair: Pair, image: Image) -> Image:
    height, width = pair.u.shape
    cut = image[pair.top : pair.top + height * pair.rows, : width * _SCALE]
    grey = cut if cut.ndim == 2 else cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)


def disparities(pair: Pair, left: Image, right: Image) -> FloatArray:
    """The disparity of each pixel of the small left picture, (H, W), in pixels of the full one. NaN
    where none is found, or where the right picture does not show the point.

    left, right: (H, W) the pictures as `reduced` gives them.
    """
    height, width = pair.u.shape
    moved: Image = cv2.warpAffine(
        right,
        pair.warp,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.uint8, copy=False)
    # Matchers leave out the first columns. These have a match here, so both pictures are padded.
    more = pair.n_disparities
    wide = [
        cv2.copyMakeBorder(image, 0, 0, more, 0, cv2.BORDER_REPLICATE).astype(np.uint8, copy=False)
        for image in (left, moved)
    ]
    found = pair.match(wide[0], wide[1], more)[:, more:]
    disparity = _SCALE * (found - pair.below_px) + pair.flat
    is_shown = pair.u - np.maximum(disparity, pair.flat) >= _SCALE * _EDGE_PX
    is_found = (found >= 0) & (found < pair.n_disparities)
    return np.where(is_found & is_shown, disparity, np.nan)


def find_plane(pair: Pair, disparity: FloatArray) -> Plane:
    """Finds the plane of the road in disparities (H, W)."""
    points = pair.points[np.isfinite(disparity.ravel()[pair.points])]
    u, v, d = (a.ravel()[points] for a in (pair.u, pair.v, disparity))
    plane = fit_plane(pair.camera, u, v, d, _SCALE * _PLANE_PX, _PLANE_SHARE)
    share = plane.share * len(points) / max(len(pair.points), 1)
    return replace(plane, share=share)


def off_plane(pair: Pair, disparity: FloatArray, plane: Plane) -> BoolArray:
    """The pixels, (H, W), that are not on the plane. A pixel without disparity counts as on it. If
    the plane is not sure, so does a pixel that would be on it at the largest allowed pitch."""
    least_px = _SCALE * (_OFF_PLANE_PX + (0 if plane.is_sure else pair.below_px))
    # A point with disparity d is above the plane by the share (d - plane's) / d of the camera's
    # height.
    least_share = _OFF_PLANE_M / pair.camera.height_m
    away = np.abs(disparity - disparity_at(plane.abc, pair.u, pair.v))
    off = (away > least_px) & (away > least_share * np.abs(disparity))
    grow = 2 * _GROW_PX + 1
    return np.asarray(cv2.dilate(off.astype(np.uint8), np.ones((grow, grow), np.uint8)) > 0)


def _watch() -> Callable[[int, Plane], None]:
    """Makes a function to call after each frame, which warns once if the plane stays unsure."""
    running = 0

    def watch(frame_id: int, plane: Plane) -> None:
        nonlocal running
        # A drive that was warned of stays so.
        running = 0 if plane.is_sure and running < _UNSURE_AFTER else running + 1
        if running == _UNSURE_AFTER:
            warnings.warn(
                f"frame {frame_id}: no road plane found in {running} frames running (do the two"
                " pictures show the same? are left and right swapped? is the pair rectified,"
                " baseline_m right?); the calibrated plane is used until there is one",
                UserWarning,
                stacklevel=2,
            )

    return watch


def _pixels(pair: Pair, view: BirdsEye) -> NDArray[np.int64]:
    """For each pixel of the view, (R, C), the flat index of the small picture's pixel there."""
    height, width = pair.u.shape
    column = np.clip(view.map_uv[0][..., 0] // _SCALE, 0, width - 1).astype(np.int64)
    row = np.clip((view.map_uv[0][..., 1] - pair.top) // pair.rows, 0, height - 1)
    return np.asarray(row.astype(np.int64) * width + column)


# --- the plane of the road -----------------------------------------------------------------------


def ground_plane(camera: Camera) -> FloatArray:
    """The coefficients (3,) of the flat road below a calibrated camera.

    A ray (right, down, 1) of the camera meets the road at Z = -h / (n . ray), where n is the upward
    direction in the camera's axes and h its height. Hence d = -(f B / h) n . ray.
    """
    assert camera.baseline_m is not None
    up = axes(camera)[:, 2]
    scale = -camera.fx * camera.baseline_m / camera.height_m
    a, b = scale * up[0] / camera.fx, scale * up[1] / camera.fy
    return np.array([a, b, scale * up[2] - a * camera.cx - b * camera.cy])


def pose(camera: Camera, planes: FloatArray) -> FloatArray:
    """The camera's height (metres), pitch and roll (degrees) above planes (..., 3), as (..., 3);
    the inverse of `ground_plane`. NaN for coefficients that are no plane."""
    assert camera.baseline_m is not None
    a, b, c = np.moveaxis(planes, -1, 0)
    up = -np.stack([a * camera.fx, b * camera.fy, c + a * camera.cx + b * camera.cy], axis=-1)
    length = np.linalg.norm(up, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = camera.fx * camera.baseline_m / length
        pitch = np.degrees(np.arcsin(np.clip(up[..., 2] / length, -1, 1)))
        roll = np.degrees(np.arctan2(-up[..., 0], -up[..., 1]))
    return np.stack([height, pitch, roll], axis=-1)


def disparity_at(plane: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """The disparity of the plane (3,) at pixels u, v."""
    return np.asarray(plane[0] * u + plane[1] * v + plane[2])


def fit_plane(
    camera: Camera,
    u: FloatArray,
    v: FloatArray,
    disparity: FloatArray,
    tolerance_px: float,
    least_share: float,
) -> Plane:
    """Finds the plane that most points lie on.

    The candidates are the calibrated plane and planes through three random points; the best one is
    refined by least squares.

    - u, v, disparity: (N,) the points, pixels; N is at most a few thousand
    - tolerance_px: largest distance of a point from a plane that it lies on, pixels
    - least_share: of the points, on a sure plane
    """
    calibrated = ground_plane(camera)
    off = disparity - disparity_at(calibrated, u, v)
    if len(off) < _POINTS:
        return Plane(calibrated, 0.0, False)
    # Points are centred and scaled so that the three equations are well conditioned.
    centre, scale = np.array([u.mean(), v.mean()]), max(float(np.ptp(u)), float(np.ptp(v)), 1.0)
    points = np.stack([(u - centre[0]) / scale, (v - centre[1]) / scale, np.ones_like(u)])

    def whole(tilt: FloatArray) -> FloatArray:
        """The planes (..., 3), in pixels, that differ from the calibrated one by `tilt` (..., 3),
        in centred and scaled points."""
        slope = tilt[..., :2] / scale
        shift = tilt[..., 2] - slope @ centre
        return np.asarray(calibrated + np.concatenate([slope, shift[..., None]], axis=-1))

    tilts = _candidates(points.T, off)
    is_possible = _possible(camera, whole(tilts))
    # The calibrated plane stays a candidate whatever rounding says.
    is_possible[0] = True
    tilts = tilts[is_possible]
    a, b, c = tilts.T[:, :, None]
    is_near = np.abs(a * points[0] + b * points[1] + c - off) <= tolerance_px
    best = tilts[int(np.argmax(is_near.sum(axis=1)))]
    for times in _ROUNDS:
        near = np.abs(best @ points - off) <= times * tolerance_px
        if near.sum() < _POINTS:
            return Plane(calibrated, float(near.mean()), False)
        design = points * near
        best = np.linalg.lstsq(design @ points.T, design @ off)[0]
    share = float((np.abs(best @ points - off) <= tolerance_px).mean())
    found = whole(best)
    is_sure = share >= least_share
    is_sure &= bool(_possible(camera, found[None])[0])
    return Plane(found if is_sure else calibrated, share, is_sure)


def _candidates(points: FloatArray, off: FloatArray) -> FloatArray:
    """The tilts to try, (K, 3): none, then those of planes through three random points each."""
    three = np.random.default_rng(0).integers(0, len(off), (_TRIALS, 3))
    matrices = points[three]
    three = three[np.abs(np.linalg.det(matrices)) > 1e-3]
    through = np.linalg.solve(points[three], off[three][..., None])[..., 0]
    return np.concatenate([np.zeros((1, 3)), through])


def _possible(camera: Camera, planes: FloatArray) -> BoolArray:
    """Whether the camera can be in the pose that planes (K, 3) ask for, (K,)."""
    height, pitch, roll = np.moveaxis(pose(camera, planes), -1, 0)
    heave = np.abs(height / camera.height_m - 1)
    possible: BoolArray = (
        (np.abs(pitch - camera.pitch_deg) <= MOST_PITCH_DEG)
        & (np.abs(roll - camera.roll_deg) <= _MOST_ROLL_DEG)
        & (heave <= _MOST_HEAVE)
    )
    return possible
