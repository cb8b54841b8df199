"""A camera above a flat road: from a point on the road to its pixel, and back.

Vehicle coordinates are in metres: x forward from the camera, y to the right (so that a line's y at
x = 0 is its offset, negative on the left), z up from the road. Picture coordinates are in pixels: u
to the right, v down. Detectors read real pictures with this model, the simulation draws with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.tools.files import write_yaml
from egolane_pgm.types import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    problems_in,
    suggestion,
)
from egolane_pgm.vision.camera.lens import COEFFICIENTS, read_keys

#: Two coordinates of points, of one shape: u and v in pixels, a and b of rays, x and y in metres.
Points = tuple[FloatArray, FloatArray]

#: Rounds of the fixed-point iteration that inverts the lens distortion.
_ROUNDS = 20

#: The largest error, in pixels, of distorting a point and removing the distortion again. If it is
#: larger, the distortion formula has folded over and would show the picture a second time.
_FOLD_PX = 1.0

#: The smallest divisor.
_TINY = 1e-12

#: The largest angle between a ray and the axis of a fisheye, radians.
_MOST_ANGLE = math.radians(89)

#: The range of each value for a camera in a car, and its unit; a value outside has a wrong unit.
RANGES = {
    "width": (16, 20_000, "pixels"),
    "height": (16, 20_000, "pixels"),
    "fx": (10, 100_000, "pixels"),
    "fy": (10, 100_000, "pixels"),
    "cx": (-20_000, 40_000, "pixels"),
    "cy": (-20_000, 40_000, "pixels"),
    "height_m": (0.2, 10, "metres above the road"),
    "pitch_deg": (-60, 60, "degrees, up is positive"),
    "yaw_deg": (-60, 60, "degrees, right is positive"),
    "roll_deg": (-60, 60, "degrees, clockwise is positive"),
    "lateral_m": (-5, 5, "metres right of the vehicle's middle"),
    "baseline_m": (0.01, 5, "metres between the two cameras"),
    "lane_width_m": (2, 6, "metres"),
}

#: The height of the lowest camera on usual cars and of the highest on lorries, metres.
USUAL_HEIGHTS = (0.9, 3.2)

#: The usual width of lanes, metres, and the widths of almost all.
USUAL_LANE_M = 3.66
LANE_WIDTHS = (2.5, 4.5)


@dataclass(frozen=True)
class Camera:
    """A calibrated camera.

    - width, height: size of the picture, pixels
    - fx, fy, cx, cy: focal lengths and principal point of the pinhole model, pixels
    - height_m: height above the road
    - pitch_deg, yaw_deg, roll_deg: turn of the camera against the direction of travel; positive
      is upwards, to the right and clockwise
    - lateral_m: distance to the right of the vehicle's middle
    - lens: the distortion model, "plumb_bob", "rational_polynomial" or "equidistant" (a fisheye)
    - distortion: OpenCV's k1, k2, p1, p2, k3 of plumb_bob, also k4 to k6 of rational_polynomial, or
      k1 to k4 of equidistant
    - baseline_m: for a rectified stereo pair, how far the second camera is to the right of this
      one; None for a single camera
    - lane_width_m: the width of the lanes that the height follows from, which detectors then
      expect; None if it does not follow from one
    - ignore: rectangles of the picture that never show road (bonnet, mirror), each left, top,
      right, bottom in pixels, the last two exclusive
    - name: for messages: the path of the YAML file; not a key of that file

    Raises InputError, naming the key, for a value that no camera in a car has.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    height_m: float
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    lateral_m: float = 0.0
    lens: str = "plumb_bob"
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    baseline_m: float | None = None
    lane_width_m: float | None = None
    ignore: tuple[tuple[int, int, int, int], ...] = ()
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name, (low, high, unit) in RANGES.items():
            value = getattr(self, name)
            if value is None and name in ("baseline_m", "lane_width_m"):
                continue
            _check_numbers(name, (value,), 1)
            if not low <= value <= high:
                raise InputError(f"{name}: {value} is not between {low} and {high} ({unit})")
        if self.lens not in COEFFICIENTS:
            raise InputError(f"lens: {self.lens!r} is not one of {', '.join(COEFFICIENTS)}")
        _check_numbers("distortion", self.distortion, COEFFICIENTS[self.lens])
        for box in self.ignore:
            _check_numbers("ignore", box, 4)
            if box[0] >= box[2] or box[1] >= box[3]:
                raise InputError("ignore: needs rectangles left, top, right, bottom, in pixels")

    @property
    def is_distorted(self) -> bool:
        """Whether the lens differs from a pinhole."""
        return self.lens == "equidistant" or any(self.distortion)


#: How to complete a file that has the lens only.
_MOUNTING = (
    "; the file has the lens only: add the line `height_m: 1.3` (metres above the road), and"
    " pitch_deg, yaw_deg and roll_deg if they are not 0"
)

#: The keys of a camera's YAML file.
_KEYS = [f.name for f in fields(Camera) if f.name != "name"]


def _check_numbers(name: str, values: object, n: int) -> None:
    """Raise InputError for a value that is not n finite numbers, whole numbers for pixels."""
    is_whole = name in ("width", "height", "ignore")
    if not (
        isinstance(values, tuple)
        and len(values) == n
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
        and all(math.isfinite(v) for v in values)
        and (not is_whole or all(v == int(v) for v in values))
    ):
        given = values[0] if n == 1 and isinstance(values, tuple) else values
        needed = f"{n} {'whole' if is_whole else 'finite'} number{'s' * (n > 1)}"
        raise InputError(f"{name}: {given!r} is not {needed}")


def said_height(camera: Camera) -> str:
    """Compare the height of the camera with cameras of cars and lorries."""
    usual = "{:g} to {:g} m".format(*USUAL_HEIGHTS)
    high = camera.height_m
    return f"the camera is {high:.2f} m above the road; cars and lorries have {usual}"


def axes(camera: Camera) -> FloatArray:
    """The camera's directions right, down and forward as the rows of a (3, 3) array, in vehicle
    coordinates (x forward, y right, z up)."""
    pitch, yaw, roll = np.deg2rad([camera.pitch_deg, camera.yaw_deg, camera.roll_deg])
    forward = np.array(
        [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)]
    )
    level = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    down = np.array(
        [math.sin(pitch) * math.cos(yaw), math.sin(pitch) * math.sin(yaw), -math.cos(pitch)]
    )
    right = math.cos(roll) * level + math.sin(roll) * down
    return np.stack([right, math.cos(roll) * down - math.sin(roll) * level, forward])


def road_to_image(
    camera: Camera, x: ArrayLike, y: ArrayLike, *, undistorted: bool = False
) -> Points:
    """Pixels u, v of points of the road; NaN for points behind the camera.

    - x, y: metres ahead and to the right, of any shapes that broadcast
    - undistorted: pixels of the picture without lens distortion
    """
    place = (np.asarray(a, dtype=np.float64) for a in (x, y, -camera.height_m))
    x, y, z = np.broadcast_arrays(*place)
    relative = np.stack([x, y - camera.lateral_m, z], axis=-1) @ axes(camera).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.where(relative[..., 2] > 1e-9, relative[..., 2], np.nan)
        a = relative[..., 0] / ahead
        b = relative[..., 1] / ahead
    return pixels_of(camera, *((a, b) if undistorted else _distort(camera, a, b)))


def road_seen(camera: Camera, x: ArrayLike, y: ArrayLike) -> Points:
    """Pixels u, v of points x, y of the road, as `road_to_image`; NaN also for points far outside
    the picture that the distortion formula folds back into it."""
    u, v = road_to_image(camera, x, y)
    if camera.is_distorted:
        free_u, free_v = road_to_image(camera, x, y, undistorted=True)
        back_u, back_v = undistorted(camera, u, v)
        with np.errstate(invalid="ignore"):
            is_folded = ~(np.hypot(back_u - free_u, back_v - free_v) < _FOLD_PX)
        u = np.where(is_folded, np.nan, u)
        v = np.where(is_folded, np.nan, v)
    return u, v


def image_to_road(
    camera: Camera, u: ArrayLike, v: ArrayLike, *, undistorted: bool = False
) -> Points:
    """Points x, y of the road, metres, that pixels show; NaN at the horizon and above.

    - u, v: pixels, of any shapes that broadcast
    - undistorted: pixels of the picture without lens distortion
    """
    a, b = rays_of(camera, u, v)
    if not undistorted:
        a, b = _undistort(camera, a, b)
    ray = np.stack([a, b, np.ones_like(a)], axis=-1) @ axes(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(ray[..., 2] < -1e-9, -camera.height_m / ray[..., 2], np.nan)
    return reach * ray[..., 0], camera.lateral_m + reach * ray[..., 1]


def is_shown(camera: Camera, u: FloatArray | IntArray, v: FloatArray | IntArray) -> BoolArray:
    """Whether pixels u, v, which broadcast, are outside the camera's `ignore` rectangles."""
    shown = np.ones(np.broadcast_shapes(u.shape, v.shape), dtype=bool)
    for left, top, right, bottom in camera.ignore:
        shown &= ~((u >= left) & (u < right) & (v >= top) & (v < bottom))
    return shown


def vanishing_point(camera: Camera) -> tuple[float, float]:
    """The pixel of the undistorted picture where lines along the direction of travel meet."""
    right, down, forward = axes(camera)[:, 0]
    return camera.cx + camera.fx * right / forward, camera.cy + camera.fy * down / forward


def level_rays(camera: Camera, u: ArrayLike, v: ArrayLike) -> FloatArray:
    """The rays (a, b, 1), a to the right and b down, of pixels u, v of the undistorted picture in
    the camera without roll: a, b, (..., 2)."""
    a, b = rays_of(camera, u, v)
    roll = math.radians(camera.roll_deg)
    return np.stack(
        [math.cos(roll) * a - math.sin(roll) * b, math.sin(roll) * a + math.cos(roll) * b], axis=-1
    )


def with_vanishing_point(camera: Camera, u: float, v: float) -> Camera:
    """Turn the camera, without changing its roll, so that lines along the direction of travel
    meet at the pixel (u, v) of the undistorted picture."""
    # In the camera without roll the ahead direction is (-tan yaw / cos pitch, tan pitch).
    a, b = level_rays(camera, u, v)
    pitch = math.atan(b)
    yaw = math.atan(-a * math.cos(pitch))
    return replace(camera, pitch_deg=math.degrees(pitch), yaw_deg=math.degrees(yaw))


def scaled(camera: Camera, width: int, height: int) -> Camera:
    """The same camera with its pictures made larger or smaller: lens, place and turn stay, pixels
    change. Rectangles to ignore cover at least the same part of the picture.

    Raises InputError for a size of another aspect ratio (by more than a pixel): such a picture was
    cut or stretched in an unknown way.
    """
    across = width / camera.width
    along = height / camera.height
    if abs(across - along) * min(camera.width, camera.height) > 1:
        raise InputError(
            f"pictures of {width}x{height} pixels have another aspect ratio than the"
            f" {camera.width}x{camera.height} that the camera was calibrated for; calibrate with"
            " pictures of this size"
        )
    ignore = tuple(
        (
            left * width // camera.width,
            top * height // camera.height,
            -(-right * width // camera.width),
            -(-bottom * height // camera.height),
        )
        for left, top, right, bottom in camera.ignore
    )
    # The middle of the first pixel is 0, so that the picture's corner is at -1/2.
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * along,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * along - 0.5,
        ignore=ignore,
    )


def rays_of(camera: Camera, u: ArrayLike, v: ArrayLike) -> Points:
    """The rays (a, b, 1), a to the right and b down, of pixels u, v of the picture without lens
    distortion, of any shapes that broadcast: a and b."""
    u, v = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
    return (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy


def pixels_of(camera: Camera, a: FloatArray, b: FloatArray) -> Points:
    """The pixels u, v of rays (a, b, 1): the inverse of `rays_of`."""
    return camera.fx * a + camera.cx, camera.fy * b + camera.cy


def undistorted(camera: Camera, u: ArrayLike, v: ArrayLike) -> Points:
    """Take pixels u, v of the picture to the picture without lens distortion."""
    return pixels_of(camera, *_undistort(camera, *rays_of(camera, u, v)))


def distorted(camera: Camera, u: ArrayLike, v: ArrayLike) -> Points:
    """Take pixels u, v of the picture without lens distortion to the picture."""
    return pixels_of(camera, *_distort(camera, *rays_of(camera, u, v)))


def _distort(camera: Camera, a: FloatArray, b: FloatArray) -> Points:
    if not camera.is_distorted:
        return a, b
    if camera.lens == "equidistant":
        radius = np.hypot(a, b)
        angle = np.arctan(radius)
        scale = _bent(camera, angle) / np.maximum(radius, _TINY)
        return a * scale, b * scale
    radial, shift_a, shift_b = _plumb_bob(camera, a, b)
    return a * radial + shift_a, b * radial + shift_b


def _undistort(camera: Camera, a: FloatArray, b: FloatArray) -> Points:
    if not camera.is_distorted:
        return a, b
    if camera.lens == "equidistant":
        radius = np.hypot(a, b)
        angle = radius
        for _ in range(_ROUNDS):
            angle = angle * radius / np.maximum(_bent(camera, angle), _TINY)
        scale = np.tan(np.clip(angle, 0, _MOST_ANGLE)) / np.maximum(radius, _TINY)
        return a * scale, b * scale
    free_a = a
    free_b = b
    for _ in range(_ROUNDS):
        radial, shift_a, shift_b = _plumb_bob(camera, free_a, free_b)
        free_a = (a - shift_a) / radial
        free_b = (b - shift_b) / radial
    return free_a, free_b


def _plumb_bob(
    camera: Camera, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The factor of a ray's distance from the axis, and the shifts of a and b that follow from the
    tangential coefficients; also of a rational polynomial."""
    k1, k2, p1, p2, k3, *further = camera.distortion
    square = a * a + b * b
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    if further:
        k4, k5, k6 = further
        radial = radial / (1 + square * (k4 + square * (k5 + square * k6)))
    shift_a = 2 * p1 * a * b + p2 * (square + 2 * a * a)
    shift_b = p1 * (square + 2 * b * b) + 2 * p2 * a * b
    return radial, shift_a, shift_b


def _bent(camera: Camera, angle: FloatArray) -> FloatArray:
    """The distance from the principal point, in focal lengths, of rays at an angle to the axis."""
    k1, k2, k3, k4 = camera.distortion
    s = angle * angle
    return angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))


def read_camera(path: str | Path, height_m: float | None = None) -> Camera:
    """The camera of a YAML file, ours or one of ROS, OpenCV or Kalibr with our keys of the mounting
    added.

    - height_m: metres, for a file that has none; by default the file must have it.

    Raises InputError, one line that names file and key, for a key that is missing, unknown or has a
    wrong value."""
    values, is_lens = read_keys(Path(path))
    values = values if height_m is None else {"height_m": height_m, **values}
    for key in values:
        if key not in _KEYS:
            raise InputError(f"{path}: unknown key '{key}'{suggestion(str(key), _KEYS)}")
    for key in ("width", "height", "fx", "fy", "cx", "cy", "height_m"):
        if key not in values:
            hint = _MOUNTING if is_lens and key == "height_m" else ""
            raise InputError(f"{path}: {key}: is missing{hint}")
    if isinstance(values.get("distortion"), list):
        values["distortion"] = tuple(values["distortion"])
    if isinstance(boxes := values.get("ignore"), list):
        values["ignore"] = tuple(tuple(box) if isinstance(box, list) else box for box in boxes)
    with problems_in(str(path)):
        return Camera(**values, name=str(path))


def write_camera(path: str | Path, camera: Camera, comment: str = "") -> None:
    """Write a camera as YAML below a comment on its calibration, and make missing
    folders. Raises InputError if the file cannot be written."""
    content = {name: getattr(camera, name) for name in _KEYS}
    content["distortion"] = list(camera.distortion)
    content["ignore"] = [list(rectangle) for rectangle in camera.ignore] or None
    above = "".join(f"# {line}\n" for line in comment.splitlines())
    if camera.lens == "plumb_bob":
        content["lens"] = None
    kept = {key: value for key, value in content.items() if value is not None}
    write_yaml(Path(path), kept, above)
