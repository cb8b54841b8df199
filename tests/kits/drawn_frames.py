"""A camera, lines and a belief to draw, and how to read a drawn frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.video import Scene, draw_frame, layout

CAMERA = Camera(
    width=640, height=400, fx=500, fy=500, cx=320, cy=200, height_m=1.4, pitch_deg=-3, yaw_deg=0.5
)
OFFSETS = (-1.9, 1.6, 5.2)
LINES = FrameLines(
    np.array([[offset, 0.0, 0.0, 0.0] for offset in OFFSETS]),
    np.array([True, True, False]),
    np.array([True, False, True]),
    np.array([10.0, 10.0, 3.0]),
)


def road(camera: Camera = CAMERA) -> np.ndarray:
    """A grey picture."""
    return np.full((camera.height, camera.width, 3), 90, dtype=np.uint8)


def scene(belief: list[float], assigned: int, **more: object) -> Scene:
    values = np.array(belief)
    return replace(Scene(7, 0.7, LINES, values, assigned), **more)  # type: ignore[arg-type]


def drawn(one: Scene) -> np.ndarray:
    return draw_frame(layout(CAMERA), road(), one)


def is_colour(pixel: np.ndarray, colour: tuple[int, int, int], tolerance: int = 12) -> bool:
    return bool((np.abs(pixel.astype(int) - colour) <= tolerance).all())


def around(image: np.ndarray, u: float, v: float) -> np.ndarray:
    """The pixels near a place."""
    row, column = round(v), round(u)
    return image[row - 1 : row + 2, column - 2 : column + 3].reshape(-1, 3)


def filled(
    image: np.ndarray, box: tuple[int, int, int, int], colour: tuple[int, int, int]
) -> float:
    """The share of a bar's height that has the colour, in its middle column."""
    left, upper, right, lower = box
    column = image[upper + 1 : lower, (left + right) // 2]
    return float(np.mean([is_colour(p, colour, 2) for p in column]))
