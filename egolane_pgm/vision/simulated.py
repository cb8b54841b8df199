"""Pictures of a simulated drive: a flat, straight road with painted lines.

    road = simulated_road("a4", seed=0, frames=600)
    write_pictures(road, Path("drive"))

The car keeps parallel to the lines, also in a lane change. The pictures need a camera, so this
module belongs to `vision`; `simulation` makes the drive, without pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from egolane_pgm.simulation.world import Road
from egolane_pgm.tools.files import make_directory
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera, image_to_road, write_camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.writing import write_picture

#: The camera of the pictures. It sees a lane to each side from 7 m ahead.
CAMERA = Camera(480, 270, 390.0, 390.0, 239.5, 134.5, height_m=1.4, pitch_deg=-4.0)

#: Speed of the car, metres per second.
SPEED_MPS = 27.0

#: Length of a dash of the inner lines, metres.
DASH_M = 4.0

#: Distance from the start of a dash to the start of the next, metres.
PERIOD_M = 12.0

#: A line farther away is too thin to be seen, metres.
_FAR_M = 80.0


@dataclass(frozen=True)
class Paint:
    """A painted line, in vehicle coordinates.

    Its place is y(x) = offset + heading x + curvature x^2 / 2 + rate x^3 / 6, x ahead and y to the
    right, metres. It is dashed if period_m > dash_m. grey: its brightness, 0 to 255.
    """

    offset_m: float
    dash_m: float = 1.0
    period_m: float = 1.0
    heading: float = 0.0
    curvature: float = 0.0
    width_m: float = 0.15
    grey: float = 225.0
    rate: float = 0.0


def draw_road(
    lines: Sequence[Paint],
    travelled_m: float = 0.0,
    *,
    camera: Camera = CAMERA,
    seed: int = 0,
    noise: float = 3.0,
) -> Image:
    """Draw one picture: grey asphalt with noise, painted lines, a lighter sky.

    - travelled_m: distance driven, which moves the dashes
    - seed: of the noise
    - noise: its standard deviation, grey levels
    """
    x, y = _road_points(camera)
    grey = np.where(np.isnan(x), 180.0, 95.0)
    is_near = x < _FAR_M
    ahead = x[is_near]
    for line in lines:
        bend = line.heading + ahead * (line.curvature / 2 + ahead * line.rate / 6)
        is_paint = np.abs(y[is_near] - (line.offset_m + ahead * bend)) < line.width_m / 2
        is_paint &= np.mod(ahead + travelled_m, line.period_m) < line.dash_m
        grey[is_near] = np.where(is_paint, line.grey, grey[is_near])
    grey += np.random.default_rng(seed).normal(0, noise, grey.shape)
    one: Image = np.clip(grey, 0, 255).astype(np.uint8)
    return np.repeat(one[:, :, None], 3, axis=2)


@lru_cache(maxsize=8)
def _road_points(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """The road point of each pixel, (H, W) each, metres ahead and to the right; NaN in the sky."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = image_to_road(camera, u, v)
    return x, y


def draw_frame(road: Road, frame: int, camera: Camera = CAMERA) -> Image:
    """Draw the picture of a frame of a simulated drive, with continuous lines outside and dashed
    ones inside; the same arguments give the same one."""
    outer, *inner, last = road.line_offset_m[frame].tolist()
    lines = [Paint(outer), *(Paint(offset, DASH_M, PERIOD_M) for offset in inner), Paint(last)]
    travelled_m = frame * SPEED_MPS / road.frame_rate
    return draw_road(lines, travelled_m, camera=camera, seed=frame)


def write_pictures(road: Road, folder: Path) -> None:
    """Write the pictures of a simulated drive: images/ and camera.yaml.

    Raises InputError if there are pictures of another drive, or if a file cannot be written.
    """
    place = folder / "images"
    if place.is_dir() and any(place.iterdir()):
        raise InputError(f"{place}: is not empty; name another folder")
    make_directory(folder)
    write_camera(folder / "camera.yaml", CAMERA, "simulated drive")
    for frame in range(len(road)):
        write_picture(place / f"{frame:06d}.jpg", draw_frame(road, frame))
