"""Draws a drive as a video. A frame shows the picture with its lines, the bird's-eye view, and the
belief as bars over the lanes from left to right, with the truth if it is known.

A valid and continuous line is blue and solid, a valid one that is not orange and dashed, also if
the detector cannot distinguish them (MLD); one that is not valid is light grey and thin. Only
one frame is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import UNASSIGNED, FloatArray
from egolane_pgm.vision.camera.model import Camera, road_seen, scaled
from egolane_pgm.vision.camera.picture import Image, as_image
from egolane_pgm.vision.detectors import FrameLines, powers

Colour = tuple[int, int, int]

#: Okabe and Ito's colours, blue green red.
CONTINUOUS: Colour = (178, 114, 0)
DASHED: Colour = (0, 159, 230)
NOT_VALID: Colour = (205, 205, 205)
ASSIGNED: Colour = (178, 114, 0)
OTHER: Colour = (236, 215, 188)
TRUTH: Colour = (0, 94, 213)
INK: Colour = (34, 34, 34)
PAPER: Colour = (255, 255, 255)
FRAME: Colour = (170, 170, 170)

#: The size of all text.
TEXT = 0.45

#: Nearest and farthest distance ahead of the camera in the bird's-eye view, metres.
AHEAD_M = (0.0, 40.0)

#: Reach of the bird's-eye view to either side, metres.
SIDE_M = 10.0

#: Distance ahead up to which lines are drawn, metres.
DRAWN_M = 60.0

#: Length of a drawn dash, metres.
DASH_M = 3.0

#: Lower pictures are enlarged to this height, so that the text fits, pixels.
LEAST_HEIGHT = 360


@dataclass(frozen=True)
class Scene:
    """The data of one frame.

    - lines: the output of a detector
    - belief: (n,) over the lanes
    - assigned: the lane that the model answers, 0 if it is not sure
    - truth: the annotated lane; None if unknown
    - sensor_ok: the probability that the sensor works; None for a graph without SensorState
    """

    frame_id: int
    time_s: float
    lines: FrameLines
    belief: FloatArray
    assigned: int
    truth: int | None = None
    sensor_ok: float | None = None


@dataclass(frozen=True)
class Layout:
    """The places of the parts of a drawn frame: the picture, the bird's-eye view to the right of it
    and the panel below both.

    - camera: of the pictures, enlarged as they are drawn
    - size: width and height of the whole, pixels
    - from_above: for each pixel of the bird's-eye view, the column and row of the picture
    """

    camera: Camera
    size: tuple[int, int]
    from_above: tuple[NDArray[np.float32], NDArray[np.float32]]


def layout(camera: Camera) -> Layout:
    """The layout for the pictures of a camera."""
    larger = max(1.0, LEAST_HEIGHT / camera.height)
    width = round(camera.width * larger)
    height = round(camera.height * larger)
    camera = scaled(camera, width, height)
    above = round(height * 2 * SIDE_M / (AHEAD_M[1] - AHEAD_M[0]))
    below = max(150, height // 4)
    # Video codecs need even sizes.
    size_x = width + above
    size_y = height + below
    size = (size_x + size_x % 2, size_y + size_y % 2)
    x = np.linspace(AHEAD_M[1], AHEAD_M[0], 2 * height + 1)[1::2]
    y = np.linspace(-SIDE_M, SIDE_M, 2 * above + 1)[1::2]
    u, v = road_seen(camera, x[:, None], y[None, :])
    # Points behind the camera are far outside the picture.
    columns, rows = (np.clip(np.nan_to_num(at, nan=-1e6), -1e6, 1e6) for at in (u, v))
    return Layout(camera, size, (columns.astype(np.float32), rows.astype(np.float32)))


def draw_frame(places: Layout, picture: Image, scene: Scene) -> Image:
    """Draw one frame, (H, W, 3), blue green red. picture: one of the camera's size."""
    canvas = np.full((places.size[1], places.size[0], 3), 255, dtype=np.uint8)
    width = places.camera.width
    height = places.camera.height
    # OpenCV only copies a picture of this size.
    shown = as_image(cv2.resize(picture, (width, height)))
    columns, rows = places.from_above
    from_above = as_image(cv2.remap(shown, columns, rows, cv2.INTER_LINEAR))
    _draw_lines(places, shown, from_above, scene.lines)
    canvas[:height, :width] = shown
    canvas[:height, width : width + from_above.shape[1]] = from_above
    _bars(places, canvas, scene)
    _legend(places, canvas, scene)
    return canvas


# --- lines ---------------------------------------------------------------------------------------


def _pieces(is_dashed: bool, last: float) -> Iterator[FloatArray]:
    """The segments ahead over which a line is drawn, metres."""
    step = DASH_M if is_dashed else last
    for start in np.arange(0.0, last, 2 * step if is_dashed else step):
        yield np.linspace(start, min(start + step, last), 12 if is_dashed else 80)


def _draw_lines(places: Layout, picture: Image, above: Image, lines: FrameLines) -> None:
    """Draw the lines on the picture and on the bird's-eye view."""
    height, width = above.shape[:2]
    for shape, is_valid, is_continuous in zip(
        lines.shape, lines.is_valid, lines.is_continuous, strict=True
    ):
        colour, thickness = (
            (CONTINUOUS if is_continuous else DASHED, 3) if is_valid else (NOT_VALID, 1)
        )
        for x in _pieces(not is_continuous, DRAWN_M):
            u, v = road_seen(places.camera, x, powers(x) @ shape)
            _stroke(picture, u, v, colour, thickness)
        for x in _pieces(not is_continuous, AHEAD_M[1]):
            u = (powers(x) @ shape + SIDE_M) * width / (2 * SIDE_M)
            v = (AHEAD_M[1] - x) * height / (AHEAD_M[1] - AHEAD_M[0])
            _stroke(above, u, v, colour, max(1, thickness - 1))


def _stroke(image: Image, u: FloatArray, v: FloatArray, colour: Colour, thickness: int) -> None:
    """Draw the part of a curve that is in or near the image."""
    reach = 4.0 * max(image.shape)
    with np.errstate(invalid="ignore"):
        there = np.isfinite(u) & np.isfinite(v) & (np.abs(u) < reach) & (np.abs(v) < reach)
    if there.sum() < 2:
        return
    # Points are in sixteenths of a pixel, for smooth curves.
    points = [np.round(16 * np.stack([u[there], v[there]], axis=1)).astype(np.int32)]
    # A pale edge makes a dark line visible on dark asphalt, a dark one a thin line on paint.
    edge = PAPER if thickness > 1 else INK
    cv2.polylines(image, points, False, edge, thickness + 2, cv2.LINE_AA, 4)
    cv2.polylines(image, points, False, colour, thickness, cv2.LINE_AA, 4)


# --- the panel below -----------------------------------------------------------------------------


def bar_boxes(places: Layout, n_lanes: int) -> list[tuple[int, int, int, int]]:
    """The left, top, right and bottom of the boxes of the bars: lanes from left to right, then
    "not sure"."""
    top = places.camera.height + 26
    bottom = places.size[1] - 42
    edges = np.linspace(12, places.camera.width - 12, n_lanes + 2)
    sides = zip(np.rint(edges[:-1] + 4), np.rint(edges[1:] - 4), strict=True)
    return [(int(left), top, int(right), bottom) for left, right in sides]


def _bars(places: Layout, canvas: Image, scene: Scene) -> None:
    n_lanes = len(scene.belief)
    for k, (left, upper, right, lower) in enumerate(bar_boxes(places, n_lanes)):
        is_lane = k < n_lanes
        is_answer = scene.assigned == (k + 1 if is_lane else UNASSIGNED)
        share = float(scene.belief[k] if is_lane else is_answer)
        height = round(share * (lower - upper))
        colour = OTHER if not is_answer else ASSIGNED if is_lane else FRAME
        if height:
            cv2.rectangle(canvas, (left, lower - height), (right, lower), colour, -1)
        cv2.rectangle(canvas, (left, upper), (right, lower), FRAME, 1)
        name = f"lane {k + 1}" if is_lane else "not sure"
        middle = (left + right) // 2
        room = right - left
        _write(canvas, name, (middle, lower + 15), room, INK, centred=True)
        if is_lane:
            text = f"{100 * share:.0f} %"
            _write(canvas, text, (middle, upper - 5), room, INK, centred=True)
            if scene.truth == k + 1:
                cv2.rectangle(canvas, (left - 3, upper - 1), (right + 3, lower + 2), TRUTH, 2)
                _write(canvas, "truth", (middle, lower + 32), room, TRUTH, centred=True)
    top = places.camera.height
    cv2.line(canvas, (0, top), (canvas.shape[1], top), FRAME, 1)


def _legend(places: Layout, canvas: Image, scene: Scene) -> None:
    left = places.camera.width + 10
    top = places.camera.height
    is_sure = scene.assigned != UNASSIGNED
    rows: list[tuple[str, Colour | None]] = [
        (f"frame {scene.frame_id}, {scene.time_s:.1f} s", None),
        (f"answer: lane {scene.assigned}" if is_sure else "no lane is sure", None),
        ("valid, continuous", CONTINUOUS),
        ("valid, dashed or unknown", DASHED),
        ("not valid", NOT_VALID),
    ]
    if scene.sensor_ok is not None:
        rows.insert(2, (f"P(sensor OK): {100 * scene.sensor_ok:.0f} %", None))
    for k, (text, colour) in enumerate(rows):
        start = left
        baseline = top + 22 + k * ((places.size[1] - top - 16) // len(rows))
        if colour is not None:
            start = left + 24
            cv2.rectangle(canvas, (left, baseline - 8), (left + 16, baseline), colour, -1)
        _write(canvas, text, (start, baseline), canvas.shape[1] - 6 - start, INK)


def _write(
    canvas: Image,
    text: str,
    at: tuple[int, int],
    room: int,
    colour: Colour,
    *,
    centred: bool = False,
) -> None:
    """Write text that begins (or has its middle) at a column and row, not wider than `room`."""
    font: Any = cv2.FONT_HERSHEY_SIMPLEX
    width = cv2.getTextSize(text, font, TEXT, 1)[0][0]
    share = min(1.0, room / width)
    left = at[0] - round(share * width) // 2 if centred else at[0]
    cv2.putText(canvas, text, (left, at[1]), font, TEXT * share, colour, 1, cv2.LINE_AA)
