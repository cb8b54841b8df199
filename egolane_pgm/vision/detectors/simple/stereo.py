"""Separate the road from the objects on it, with a second camera (paper, section
`section:simple-line-detector`).

Matchers prefer surfaces that face the camera and lag behind on a road that runs away from it. So
the right picture is first moved by the disparities of the calibrated road. A flat road then has the
same disparity everywhere, and the matcher finds how much nearer than the road objects are.

A point Z metres away along the optical axis lies f B / Z pixels farther left in the second picture.
On a flat road this disparity is linear in the pixel, d = a u + b v + c, and it is 0 at the horizon
("the ground plane equation" of the paper). Pixels are of the first picture, rectified and at
full size.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, problems_in
from egolane_pgm.vision.camera.model import Camera, axes, image_to_road, is_shown, road_to_image
from egolane_pgm.vision.camera.picture import Image, Picture, as_image, check_size, rectangle
from egolane_pgm.vision.detectors.simple.birdseye import VIEWS, BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.finder import OnRoad

PARAMETERS = (
    Parameter(
        "matcher",
        "choice",
        "sgbm",
        "stereo matcher: sgbm (semi-global matching, of OpenCV) or elas (Geiger, Roser and Urtasun"
        " 2010; the extra elas)",
        choices=("sgbm", "elas"),
    ),
    Parameter(
        "match_rows",
        "integer",
        0,
        "number of rows of the pictures that become one to match; several make the matches of plain"
        " surfaces more certain and faster (0: 4 with sgbm, 2 with elas)",
        lowest=0,
        highest=100,
    ),
)

#: Factor by which pictures are made narrower to match.
_SCALE = 2

#: `match_rows` of each matcher. On drawn pairs with faint grain, the plane of ELAS is off by 0.5
#: degrees with 4 rows, and by 0.1 degrees with 2; more than 2 do not fit into small pictures.
_MATCH_ROWS = {"sgbm": 4, "elas": 2}

#: The smallest distance that is matched, metres.
_NEAREST_M = 4.0

#: Least height of objects above or below the plane, metres.
_OFF_PLANE_M = 0.25

#: Frames in a row without a plane, or with most of the road unknown, for a warning of it.
_UNSURE_AFTER = 20

#: Share of the road without a match that is most of it.
_MOSTLY = 0.5
_NO_PLANE = (
    "no road plane was found (do the two pictures show the same? are left and right swapped? is"
    " the pair rectified, baseline_m right?); the calibrated plane is used instead"
)
_UNKNOWN = (
    "most of the road has no match, and counts as road: nothing that stands on it is dropped"
    " (another matcher or match_rows, or larger pictures, may match more)"
)

#: From two small grey pictures (H, W) and the number of searched disparities to the disparity of
#: each pixel of the left one, (H, W); negative if unknown.
Match = Callable[[Image, Image, int], FloatArray]

#: Side of the blocks that are compared by `cv2.StereoSGBM`, pixels as matched.
_BLOCK_PX = 5

#: The fewest rows of a picture to match; ELAS crashes with fewer than about 40.
_LEAST_ROWS = {"sgbm": 16, "elas": 48}

#: The package has no wheel, and its build does not find NumPy's headers.
_INSTALL_ELAS = (
    'CPLUS_INCLUDE_PATH=$(python -c "import numpy; print(numpy.get_include())")'
    " pip install 'egolane-pgm[elas]'"
)

#: Largest distance of a road disparity from the plane, pixels as matched.
_PLANE_PX = 0.5

#: Least distance of an object's disparity from the plane, pixels as matched.
_OFF_PLANE_PX = 1.0

#: Margin around objects, pixels as matched.
_GROW_PX = 2

#: Width of the right picture's edge without good matches, pixels as matched.
_EDGE_PX = 8

#: Step of the pitch correction, degrees.
_PITCH_STEP_DEG = 0.1

#: Largest number of points that a plane is fitted to.
_MOST_POINTS = 3000

#: Number of random triples of points that are tried.
_TRIALS = 100

#: Least number of points of a plane.
_POINTS = 200

#: Least share of all points that are in the plane.
_PLANE_SHARE = 0.4

#: Largest difference of a plane's pitch from the calibrated one, degrees.
_MOST_PITCH_DEG = 2.5

#: Largest difference of a plane's roll from the calibrated one, degrees.
_MOST_ROLL_DEG = 1.5

#: Largest difference of the camera's height from the calibrated one, as a share of it.
_MOST_HEAVE = 0.12

#: Distance from the plane within which points count in each round of least squares, in tolerances.
_ROUNDS = (2.0, 1.5, 1.0, 1.0)


@dataclass(frozen=True)
class Pair:
    """The matching of the pairs of pictures of one camera as H x W pixels.

    - rows: height of a small pixel, rows of the full picture; its width is _SCALE
    - top: first row of the full picture that is used
    - flat: (H, W) disparities of the calibrated plane
    - u, v: (H, W) pixel of the full picture at the middle of each small pixel
    - points: (N,) flat indices of the small pixels that the plane is fitted to: the pixels of the
      road in both pictures, or some of them
    - below_px: range of the search below the road's disparity, small pixels
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
    points: IntArray
    below_px: int
    n_disparities: int
    warp: FloatArray
    match: Match


def on_road(view: BirdsEye, parameters: Parameters) -> OnRoad:
    """Make the `on_road` of `finder.start`: the function that takes a picture of both cameras and
    returns the view with this frame's pitch and its pixels (R, C) on the road.

    Raises InputError for a camera with lens distortion.
    """
    camera = view.camera
    if camera.is_distorted:
        raise InputError(
            "distortion: a stereo pair must be rectified, and then has none: rectify the pictures"
            " and set all five numbers to 0"
        )
    pair = make_pair(camera, parameters)
    turned = turned_up(view)
    unsure = Counter[str]()

    @lru_cache(maxsize=VIEWS)
    def pitched(steps: int) -> tuple[BirdsEye, IntArray]:
        """Return the view with a pitch, and the flat index of the small pixel of each pixel."""
        seen = turned(steps * _PITCH_STEP_DEG)
        height, width = pair.u.shape
        u, v = np.moveaxis(seen.map_uv[0].astype(np.int64), -1, 0)
        row = np.clip((v - pair.top) // pair.rows, 0, height - 1)
        return seen, row * width + np.clip(u // _SCALE, 0, width - 1)

    def look(picture: Picture) -> tuple[BirdsEye, BoolArray]:
        disparity = disparities(pair, picture)
        plane = find_plane(pair, disparity)
        is_unknown = np.isnan(disparity.ravel()[pair.points]).mean() > _MOSTLY
        for text, is_so in ((_NO_PLANE, plane is None), (_UNKNOWN, is_unknown)):
            unsure[text] = unsure[text] + 1 if is_so else 0
            if unsure[text] == _UNSURE_AFTER:
                warnings.warn(
                    f"frame {picture.frame_id}: in {_UNSURE_AFTER} frames in a row {text}",
                    stacklevel=2,
                )
        away = 0.0 if plane is None else float(pose(camera, plane)[1]) - camera.pitch_deg
        seen, pixels = pitched(round(away / _PITCH_STEP_DEG))
        return seen, ~off_plane(pair, disparity, plane).ravel()[pixels]

    return look


def make_pair(camera: Camera, parameters: Parameters) -> Pair:
    """Prepare the matching of a camera's pairs.

    Raises InputError if the pictures would become too small, or the baseline is too long for them.
    """
    matcher = str(parameters["matcher"])
    rows = int(number(parameters, "match_rows")) or _MATCH_ROWS[matcher]
    # The rows that may show the searched region of the road at the largest allowed pitch; without
    # that pitch they are multiples of 4.
    y = np.linspace(-1, 1, 9) * number(parameters, "side_m")
    _, above = road_to_image(camera, number(parameters, "x_max_m"), y)
    _, below = road_to_image(camera, number(parameters, "x_min_m"), y)
    slack = math.tan(math.radians(_MOST_PITCH_DEG)) * camera.fy
    first_row = 4 * np.ceil(np.nanmin(above).clip(0) / 4) - slack
    last_row = 4 * np.floor(np.nanmax(below).clip(max=camera.height - 1) / 4) + 4 + slack
    top = max(int(first_row), 0)
    bottom = min(int(last_row), camera.height)
    height = (bottom - top) // rows
    width = camera.width // _SCALE
    least = _LEAST_ROWS[matcher]
    if height < least or width < 64:
        raise InputError(
            f"match_rows: {rows} leaves {width}x{height} pixels of the road to match, and {matcher}"
            f" needs 64x{least}; make it smaller, or take larger pictures"
        )
    half = (_SCALE - 1) / 2
    half_row = (rows - 1) / 2
    u, v = np.meshgrid(np.arange(width) * _SCALE + half, np.arange(height) * rows + half_row + top)
    road = ground_plane(camera)
    flat = disparity_at(road, u, v)
    x, y = image_to_road(camera, u, v)
    with np.errstate(invalid="ignore"):
        is_used = (x < number(parameters, "x_max_m")) & (np.abs(y) <= number(parameters, "side_m"))
    is_used &= u >= flat + _SCALE * _EDGE_PX
    is_used &= is_shown(camera, u, v)
    every = max(math.ceil(math.sqrt(is_used.sum() / _MOST_POINTS)), 1)
    grid = np.zeros_like(is_used)
    grid[::every, ::every] = True
    assert camera.baseline_m is not None
    full = camera.fx * camera.baseline_m
    below_px = math.ceil(math.radians(_MOST_PITCH_DEG) * full / camera.height_m / _SCALE) + 2
    nearest_px = (full / _NEAREST_M - max(float(flat.min()), 0.0)) / _SCALE
    n_disparities = 16 * math.ceil((below_px + max(nearest_px, 1)) / 16)
    if n_disparities >= width:
        raise InputError(
            f"baseline_m: objects {_NEAREST_M:g} m ahead are {n_disparities * _SCALE} pixels apart"
            f" in the two pictures, which are {camera.width} wide; is it right?"
        )
    a, b, c = road
    first = c + a * half + b * (half_row + top)
    warp = np.array([[1 - a, -b * rows / _SCALE, below_px - first / _SCALE], [0, 1, 0]])
    match = _elas() if matcher == "elas" else _sgbm
    points = np.flatnonzero(is_used & grid)
    return Pair(camera, rows, top, flat, u, v, points, below_px, n_disparities, warp, match)


def _sgbm(left: Image, right: Image, n_disparities: int) -> FloatArray:
    area = _BLOCK_PX**2
    matcher = cv2.StereoSGBM.create(
        numDisparities=n_disparities,
        blockSize=_BLOCK_PX,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=1,
    )
    # OpenCV counts in sixteenths of a pixel.
    return np.asarray(matcher.compute(left, right) / 16)


def _elas() -> Match:
    """Make the matcher ELAS. Raises InputError if its package is not installed."""
    try:
        from elas import Elas
    except ImportError:
        raise InputError(f"matcher: elas is not installed: {_INSTALL_ELAS}") from None
    kept: list[Image] = []

    def match(left: Image, right: Image, n_disparities: int) -> FloatArray:
        # pyelas keeps every array that it gets, so it gets the same two each time.
        if not kept or kept[0].shape != left.shape:
            kept[:] = np.empty_like(left, order="C"), np.empty_like(right, order="C")
        kept[0][:] = left
        kept[1][:] = right
        matcher = Elas()
        matcher.disp_max = n_disparities - 1
        return np.asarray(matcher.process(*kept)[0], dtype=np.float64)

    return match


def disparities(pair: Pair, picture: Picture) -> FloatArray:
    """Return the disparity of each small pixel of the left picture, (H, W), in pixels of the full
    one; NaN if none is found, or if the right picture does not show the point.

    Raises InputError if a picture is missing or has another size than the calibration.
    """
    if picture.right is None:
        raise InputError("the picture of the second camera is missing")
    height, width = pair.u.shape
    small = []
    for name, image in (("left", picture.image), ("right", picture.right)):
        with problems_in(name):
            check_size(image, pair.camera.width, pair.camera.height)
        cut = image[pair.top : pair.top + height * pair.rows, : width * _SCALE]
        grey = cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY)
        small.append(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA))
    left, right = small
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(
        right, pair.warp, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    # Matchers leave out the first columns. These have a match here, so both pictures are padded.
    more = pair.n_disparities
    wide = [
        as_image(cv2.copyMakeBorder(image, 0, 0, more, 0, cv2.BORDER_REPLICATE))
        for image in (left, moved)
    ]
    found = pair.match(wide[0], wide[1], more)[:, more:]
    disparity = _SCALE * (found - pair.below_px) + pair.flat
    is_shown = pair.u - np.maximum(disparity, pair.flat) >= _SCALE * _EDGE_PX
    return np.where(is_shown & (found >= 0) & (found < pair.n_disparities), disparity, np.nan)


def find_plane(pair: Pair, disparity: FloatArray) -> FloatArray | None:
    """Find the plane (3,) of the road in disparities (H, W); None if too few points lie on it."""
    points = pair.points[np.isfinite(disparity.ravel()[pair.points])]
    u, v, d = (a.ravel()[points] for a in (pair.u, pair.v, disparity))
    return fit_plane(pair.camera, u, v, d)


def off_plane(pair: Pair, disparity: FloatArray, plane: FloatArray | None) -> BoolArray:
    """Return the pixels, (H, W), that are not on the plane (3,), or None if unknown.

    A pixel without disparity counts as on it. Without a plane, so does a pixel that would be on the
    calibrated one at the largest allowed pitch.
    """
    least_px = _SCALE * (_OFF_PLANE_PX + (pair.below_px if plane is None else 0))
    plane = ground_plane(pair.camera) if plane is None else plane
    # A point with disparity d is above the plane by the share (d - plane's) / d of the camera's
    # height.
    least_share = _OFF_PLANE_M / pair.camera.height_m
    away = np.abs(disparity - disparity_at(plane, pair.u, pair.v))
    off = (away > least_px) & (away > least_share * np.abs(disparity))
    grow = 2 * _GROW_PX + 1
    return np.asarray(cv2.dilate(off.astype(np.uint8), rectangle(grow, grow)) > 0)


# --- the plane of the road -----------------------------------------------------------------------


def ground_plane(camera: Camera) -> FloatArray:
    """Return the coefficients (3,) of the flat road below a calibrated camera.

    A ray (right, down, 1) of the camera meets the road at Z = -h / (n . ray), with the upward
    direction n in the camera's axes and its height h, so d = -(f B / h) n . ray.
    """
    assert camera.baseline_m is not None
    up = axes(camera)[:, 2]
    scale = -camera.fx * camera.baseline_m / camera.height_m
    a = scale * up[0] / camera.fx
    b = scale * up[1] / camera.fy
    return np.array([a, b, scale * up[2] - a * camera.cx - b * camera.cy])


def pose(camera: Camera, planes: FloatArray) -> FloatArray:
    """Return the camera's height (metres), pitch and roll (degrees), (..., 3), above planes
    (..., 3): the inverse of `ground_plane`. NaN for coefficients that do not describe a plane."""
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
    """Return the disparity of the plane (3,) at pixels u, v."""
    return np.asarray(plane[0] * u + plane[1] * v + plane[2])


def fit_plane(
    camera: Camera, u: FloatArray, v: FloatArray, disparity: FloatArray
) -> FloatArray | None:
    """Find the plane (3,) with most of the points u, v, disparity (N,) on it, pixels.

    The candidates are the calibrated plane and planes through random triples of points; the best
    one is refined by least squares. None if too few points are on it, or if the camera cannot be in
    this pose.
    """
    if len(u) < _POINTS:
        return None
    points = np.stack([u, v, np.ones_like(u)], axis=1)
    tolerance_px = _SCALE * _PLANE_PX
    three = np.random.default_rng(0).integers(0, len(u), (_TRIALS, 3))
    # Twice the area of the triangle, square pixels: small ones determine no plane.
    three = three[np.abs(np.linalg.det(points[three])) > 1e-3 * max(np.ptp(u), np.ptp(v), 1) ** 2]
    through = np.linalg.solve(points[three], disparity[three][..., None])[..., 0]
    through = through[_is_possible(camera, through)]
    candidates = np.concatenate([ground_plane(camera)[None], through])
    is_near = np.abs(candidates @ points.T - disparity) <= tolerance_px
    best = candidates[int(np.argmax(is_near.sum(axis=1)))]
    for times in _ROUNDS:
        near = np.abs(points @ best - disparity) <= times * tolerance_px
        if near.sum() < _POINTS:
            return None
        best = np.linalg.lstsq(points[near], disparity[near])[0]
    share = (np.abs(points @ best - disparity) <= tolerance_px).mean()
    return best if share >= _PLANE_SHARE and _is_possible(camera, best) else None


def _is_possible(camera: Camera, planes: FloatArray) -> BoolArray:
    """Return whether the camera can be in the pose of planes (..., 3), (...)."""
    height, pitch, roll = np.moveaxis(pose(camera, planes), -1, 0)
    return np.asarray(
        (np.abs(pitch - camera.pitch_deg) <= _MOST_PITCH_DEG)
        & (np.abs(roll - camera.roll_deg) <= _MOST_ROLL_DEG)
        & (np.abs(height / camera.height_m - 1) <= _MOST_HEAVE)
    )
