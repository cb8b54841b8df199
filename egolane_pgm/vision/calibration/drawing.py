"""Draws a calibration on a still, so that one can check it by eye."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.calibration.straight_road import (
    RoadView,
    from_level_to_image,
    near_y,
    to_level,
)
from egolane_pgm.vision.camera.model import road_seen
from egolane_pgm.vision.camera.picture import Image

Colour = tuple[int, int, int]

# Colours that colour-blind readers can tell apart, blue green red.
_FOUND, _HORIZON, _LANE, _METRE = (167, 121, 204), (233, 180, 86), (0, 159, 230), (235, 235, 235)

#: The part of the road that is drawn: from and to, metres ahead, and metres to either side.
_NEAR, _FAR, _BESIDE = 4.0, 60.0, 9

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_view(image: Image, view: RoadView, lines: Sequence[FloatArray]) -> Image:
    """Draws a road view on a still: the points of the lines, the horizon, a grid of 1 m by 10 m
    (white), and lanes of the given width (orange) that start at the nearest line on the left.

    - image: (H, W, 3), blue green red; it is not changed
    - lines: the points (N, 2) of each line, pixels
    """
    canvas: Image = image.copy()
    ahead = np.geomspace(_NEAR, _FAR, 60)
    for metre in range(-_BESIDE, _BESIDE + 1):
        _draw_path(canvas, *road_seen(view.camera, ahead, metre), _METRE, 1)
    across = np.linspace(-_BESIDE, _BESIDE, 60)
    for x in range(10, int(_FAR) + 1, 10):
        _draw_path(canvas, *road_seen(view.camera, x, across), _METRE, 1)
        at = np.array(road_seen(view.camera, x, 0))
        if np.isfinite(at).all() and x <= 30:
            _write(canvas, f"{x} m", at, _METRE)
    start = _left_line(view, lines)
    for k in range(-3, 4):
        y = start + k * view.lane_width_m
        if abs(y) <= _BESIDE:
            _draw_path(canvas, *road_seen(view.camera, ahead, y), _LANE, 2)
    for points in lines:
        for u, v in np.rint(points).astype(int):
            cv2.circle(canvas, (int(u), int(v)), 2, _FOUND, -1)
    _draw_horizon(canvas, view)
    return canvas


def _left_line(view: RoadView, lines: Sequence[FloatArray]) -> float:
    """Offset of the nearest line on the left, metres; without one, half a lane to the left."""
    offsets = [float(np.median(y)) for points in lines if len(y := near_y(view, points))]
    return max((y for y in offsets if y < 0), default=-view.lane_width_m / 2)


def _draw_path(canvas: Image, u: FloatArray, v: FloatArray, colour: Colour, thick: int) -> None:
    seen = np.isfinite(u) & np.isfinite(v)
    whole = np.rint(np.stack([u[seen], v[seen]], axis=-1)).astype(np.int32)
    cv2.polylines(canvas, [whole.reshape(-1, 1, 2)], False, colour, thick, cv2.LINE_AA)


def _draw_horizon(canvas: Image, view: RoadView) -> None:
    camera = view.camera
    wide = 0.7 * camera.width / camera.fx
    middle = to_level(camera, np.array([camera.width / 2]), np.array([camera.height / 2]))[0, 0]
    a = np.linspace(middle - wide, middle + wide, 60)
    rays = np.stack([a, np.full_like(a, view.ahead[1])], axis=-1)
    _draw_path(canvas, *from_level_to_image(camera, rays), _HORIZON, 1)
    at = np.stack(from_level_to_image(camera, view.ahead), axis=-1)
    place = tuple(int(value) for value in np.rint(at))
    cv2.drawMarker(canvas, place, _HORIZON, cv2.MARKER_CROSS, 25, 2)
    _write(canvas, "horizon", at + np.array([14, -8]), _HORIZON)


def _write(canvas: Image, text: str, at: FloatArray, colour: Colour) -> None:
    place = (int(at[0]) + 3, int(at[1]) - 3)
    cv2.putText(canvas, text, place, _FONT, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(canvas, text, place, _FONT, 0.5, colour, 1, cv2.LINE_AA)
