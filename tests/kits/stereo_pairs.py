"""Rendered pairs of pictures, and what the stereo module finds in them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import sl
from egolane_pgm.vision.detectors.simple import stereo as _stereo
from egolane_pgm.vision.detectors.simple.plane import Plane
from egolane_pgm.vision.rendering import traffic as traffics
from egolane_pgm.vision.rendering.render import Frame, render_frame
from egolane_pgm.vision.rendering.scene import FAILURES, Scene, make_scene

PAIR = Camera(640, 300, 500.0, 520.0, 310.0, 120.0, 1.4, pitch_deg=-2.0, baseline_m=0.4)
K = 20
CLEAR: dict[str, Any] = dict.fromkeys(FAILURES, 0.0)


def settled(**more: Any) -> Parameters:
    return {**resolve_parameters(sl.PARAMETERS, more, 1), "curve": "line"}


@cache
def scene(**more: float) -> Scene:
    return make_scene("a4", 3, 60, stereo=True, **{**CLEAR, **more})


@cache
def empty() -> Frame:
    return render_frame(scene(), K)


def with_vehicle(x_m: float, lane: int, *, lorry: bool) -> Scene:
    """A dark car or a white lorry, its rear x_m ahead, so many lanes to the right of the car."""
    d_m = float(scene().road.position_m[K]) + 3.75 * lane
    size = (14.0, 2.5, 3.6) if lorry else (4.5, 1.8, 1.6)
    length, width, height = (np.array([value]) for value in size)
    paint = np.array([[240.0, 240.0, 240.0] if lorry else [28.0, 28.0, 30.0]])
    one = traffics.Traffic(
        np.array([[-1e3, 0.0, 1e3, 2e3]]),
        np.full((1, 4), x_m),
        np.array([d_m]),
        length,
        width,
        height,
        paint,
        np.array([lorry]),
    )
    return replace(scene(), traffic=one)


def picture(frame: Frame) -> Picture:
    return Picture(frame.frame_id, frame.image, frame.right)


def plane_of(frame: Frame, camera: Camera, **more: Any) -> tuple[_stereo.Pair, Plane, FloatArray]:
    """How its pairs are matched, the plane that was found, and the disparities."""
    parameters = settled(**more)
    pair = _stereo.make_pair(camera, parameters)
    disparity = _stereo.disparities(pair, *_stereo.reduced(pair, picture(frame)))
    return pair, _stereo.find_plane(pair, disparity, parameters), disparity
