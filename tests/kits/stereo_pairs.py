"""Drawn pairs of pictures, and what the stereo module finds in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np

from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors import sl
from egolane_pgm.vision.detectors.simple import stereo as _stereo
from egolane_pgm.vision.simulated import DASH_M, PERIOD_M, Paint, draw_road
from tests.kits.vehicles import Vehicle, with_vehicles

#: A pair for geometry alone, and the one that pictures are drawn for.
PAIR = Camera(640, 300, 500.0, 520.0, 310.0, 120.0, 1.4, pitch_deg=-2.0, baseline_m=0.4)
DRAWN = Camera(1312, 540, 760.0, 760.0, 655.5, 215.0, 1.5, pitch_deg=-1.0, baseline_m=0.4)
OFFSETS = np.array([-5.3, -1.55, 2.2, 5.95, 9.7])
LINES = (
    Paint(OFFSETS[0]),
    *(Paint(offset, DASH_M, PERIOD_M) for offset in OFFSETS[1:-1]),
    Paint(OFFSETS[-1]),
)
K = 20

#: Size of the asphalt's grains, metres, and how bright they are, grey levels.
_GRAIN_M, _GRAIN = 0.15, 10.0


@dataclass(frozen=True)
class Drawn:
    """A pair of pictures. camera: with the pitch of this frame."""

    frame_id: int
    camera: Camera
    image: Image
    right: Image

    @property
    def picture(self) -> Picture:
        return Picture(self.frame_id, self.image, self.right)


@cache
def drawn(k: int = K, vehicles: tuple[Vehicle, ...] = (), more_pitch_deg: float = 0.0) -> Drawn:
    """Frame k of a drive on a straight road with grainy asphalt."""
    camera = replace(DRAWN, pitch_deg=DRAWN.pitch_deg + more_pitch_deg)
    assert camera.baseline_m is not None
    second = replace(camera, lateral_m=camera.lateral_m + camera.baseline_m)
    left, right = (
        _draw(each, k, vehicles, seed) for each, seed in ((camera, k), (second, 1000 + k))
    )
    return Drawn(k, camera, left, right)


def _draw(camera: Camera, k: int, vehicles: Sequence[Vehicle], seed: int) -> Image:
    image = draw_road(LINES, 2.7 * k, camera=camera, seed=seed, noise=1.5)
    grains = np.random.default_rng(0).normal(0, 1, (255, 255)).astype(np.float32)
    grains = np.pad(grains, (0, 1), mode="wrap")
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = image_to_road(camera, u, v)
    at = [np.nan_to_num(np.mod(d / _GRAIN_M, 255)).astype(np.float32) for d in (y, x + 2.7 * k)]
    seen = np.where(np.isnan(x), 0, _GRAIN * cv2.remap(grains, *at, cv2.INTER_LINEAR))
    image = np.clip(image + seen[..., None], 0, 255).astype(np.uint8)
    return with_vehicles(image, camera, vehicles)[0]


def settled(**more: Any) -> Parameters:
    return {**resolve_parameters(sl.PARAMETERS, more, 1), "curve": "line"}


def plane_of(
    frame: Drawn, camera: Camera, **more: Any
) -> tuple[_stereo.Pair, FloatArray | None, FloatArray]:
    """The pair, the plane that was found, and the disparities."""
    parameters = settled(**more)
    pair = _stereo.make_pair(camera, parameters)
    disparity = _stereo.disparities(pair, frame.picture)
    return pair, _stereo.find_plane(pair, disparity), disparity
