"""What the rendered world is drawn with: flat shapes, paler the farther away they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Image

#: Blue green red.
Colour = tuple[float, float, float]

#: Takes x, y, z in vehicle coordinates (metres) to the pixels u, v.
Project = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]

#: The colour of the horizon.
HAZE: Colour = (222.0, 214.0, 205.0)


@dataclass(frozen=True)
class View:
    """A picture that is drawn, and the road before the car.

    - image: (H, W, 3), blue green red, which is drawn into
    - side: how far to the right the road bends, metres, at x metres ahead
    - s0: where the car is along the road, metres
    """

    image: Image
    project: Project
    side: Callable[[FloatArray], FloatArray]
    s0: float


def hazed(colour: Colour | FloatArray, x: float) -> Colour:
    """A colour as seen through x metres of air."""
    far = 1 - np.exp(-max(x, 0.0) / 500.0)
    mixed = (1 - far) * np.array(colour) + far * np.array(HAZE)
    return float(mixed[0]), float(mixed[1]), float(mixed[2])


def fill(image: Image, u: FloatArray, v: FloatArray, colour: Colour) -> None:
    """Fills a polygon with smooth edges; u, v are pixels. A corner that is not finite skips it."""
    if not (np.isfinite(u).all() and np.isfinite(v).all()):
        return
    points = np.stack([np.clip(u, -9000, 9000), np.clip(v, -9000, 9000)], axis=-1)
    cv2.fillPoly(image, [np.round(points * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)


def band(view: View, x: FloatArray, y: FloatArray, low: float, high: float, colour: Colour) -> None:
    """Fills what stands on the path x, y (P,) of the road, `low` to `high` metres above it."""
    z = np.repeat([low, high], len(x)).astype(np.float64)
    u, v = view.project(np.concatenate([x, x[::-1]]), np.concatenate([y, y[::-1]]), z)
    fill(view.image, u, v, colour)
