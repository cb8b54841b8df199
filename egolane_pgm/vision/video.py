"""Draws a drive as a video. A frame shows the picture with its lines, the bird's-eye view, and the
belief as bars over the lanes from left to right, with the truth if it is known.

A valid and continuous line is blue and solid, a valid one that is not orange and dashed, also if
the detector cannot distinguish them (MLD); one that is not valid is light grey and thin. Only
one frame is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import tee
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import UNASSIGNED, FloatArray
from egolane_pgm.vision.camera.model import Camera, road_seen, scaled
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors import FrameLines, powers
from egolane_pgm.vision.detectors.runner import Detector, detect

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

#: The bird's-eye view: from and to, metres ahead of the camera, and metres to either side.
AHEAD_M, SIDE_M = (0.0, 40.0), 10.0

#: How far ahead lines are drawn, and the length of a dash, metres.
DRAWN_M, DASH_M = 60.0, 3.0

#: Lower pictures are enlarged to this height, so that the text fits, pixels.
LEAST_HEIGHT = 360


@dataclass(frozen=True)
class Scene:
    """The data of one frame.

    - lines: as a detector gives them
    - belief: (n,) over the lanes
    - assigned: the lane that the model answers, 0 for Unassigned
    - truth: the annotated lane; None without one
    """

    frame_id: int
    time_s: float
    lines: FrameLines
    belief: FloatArray
    assigned: int
    truth: int | None = None


@dataclass(frozen=True)
class Layout:
    """The places of the parts of a drawn frame, in pixels.

    - camera: of the pictures, enlarged as they are drawn
    - picture: width and height of the picture
    - birdseye: width and height of the bird's-eye view, to the right of the picture
    - panel: top and height of the panel below both
    - size: width and height of the whole
    - from_above: for each pixel of the bird's-eye view, the column and row of the picture
    """

    camera: Camera
    picture: tuple[int, int]
    birdseye: tuple[int, int]
    panel: tuple[int, int]
    size: tuple[int, int]
    from_above: tuple[NDArray[np.float32], NDArray[np.float32]]


def layout(camera: Camera) -> Layout:
    """The layout for the pictures of a camera."""
    larger = max(1.0, LEAST_HEIGHT / camera.height)
    width, height = round(camera.width * larger), round(camera.height * larger)
    camera = scaled(camera, width, height)
    above = round(height * 2 * SIDE_M / (AHEAD_M[1] - AHEAD_M[0]))
    below = max(150, height // 4)
    # Video codecs need even sizes.
    size_x, size_y = width + above, height + below
    size = (size_x + size_x % 2, size_y + size_y % 2)
    x = np.linspace(AHEAD_M[1], AHEAD_M[0], 2 * height + 1)[1::2]
    y = np.linspace(-SIDE_M, SIDE_M, 2 * above + 1)[1::2]
    u, v = road_seen(camera, x[:, None], y[None, :])
    # Points behind the camera are far outside the picture.
    columns, rows = (np.clip(np.nan_to_num(at, nan=-1e6), -1e6, 1e6) for at in (u, v))
    panel, from_above = (
        (height, size[1] - height),
        (columns.astype(np.float32), rows.astype(np.float32)),
    )
    return Layout(camera, (width, height), (above, height), panel, size, from_above)


def draw_frame(places: Layout, picture: Image, scene: Scene) -> Image:
    """Draws one frame, (H, W, 3), blue green red. picture: one of the camera's size."""
    canvas = np.full((places.size[1], places.size[0], 3), 255, dtype=np.uint8)
    width, height = places.picture
    above = places.birdseye[0]
    # OpenCV only copies a picture of this size.
    shown = np.asarray(cv2.resize(picture, (width, height)), dtype=np.uint8)
    columns, rows = places.from_above
    from_above = np.asarray(cv2.remap(shown, columns, rows, cv2.INTER_LINEAR), dtype=np.uint8)
    _lines_on_picture(places, shown, scene.lines)
    _lines_from_above(places, from_above, scene.lines)
    canvas[:height, :width] = shown
    canvas[:height, width : width + above] = from_above
    _bars(places, canvas, scene)
    _legend(places, canvas, scene)
    return canvas


# --- the frames of a drive ----------------------------------------------------------------------


def with_detected_lines(
    pictures: Iterable[Picture], detector: Detector, camera: Camera
) -> Iterator[tuple[Picture, FrameLines]]:
    """Yields each picture with the lines that a detector sees in it."""
    # The detector takes one picture at a time, so no more than one is kept.
    seen, given = tee(pictures)
    for picture, (_, lines) in zip(seen, detect(detector, camera, given), strict=True):
        yield picture, lines


# --- lines ---------------------------------------------------------------------------------------


def _style(lines: FrameLines, k: int) -> tuple[Colour, int, bool]:
    """The colour and thickness of line k, and whether it is dashed."""
    is_dashed = not lines.is_continuous[k]
    if not lines.is_valid[k]:
        return NOT_VALID, 1, is_dashed
    return DASHED if is_dashed else CONTINUOUS, 3, is_dashed


def _pieces(is_dashed: bool, last: float) -> Iterator[FloatArray]:
    """The segments ahead over which a line is drawn, metres."""
    step = DASH_M if is_dashed else last
    for start in np.arange(0.0, last, 2 * step if is_dashed else step):
        yield np.linspace(start, min(start + step, last), 12 if is_dashed else 80)


def _lines_on_picture(places: Layout, picture: Image, lines: FrameLines) -> None:
    for k in range(len(lines.is_valid)):
        colour, thickness, is_dashed = _style(lines, k)
        for x in _pieces(is_dashed, DRAWN_M):
            u, v = road_seen(places.camera, x, powers(x) @ lines.shape[k])
            _stroke(picture, u, v, colour, thickness)


def _lines_from_above(places: Layout, view: Image, lines: FrameLines) -> None:
    width, height = places.birdseye
    per_metre = height / (AHEAD_M[1] - AHEAD_M[0])
    for k in range(len(lines.is_valid)):
        colour, thickness, is_dashed = _style(lines, k)
        for x in _pieces(is_dashed, AHEAD_M[1]):
            u = (powers(x) @ lines.shape[k] + SIDE_M) * width / (2 * SIDE_M)
            _stroke(view, u, (AHEAD_M[1] - x) * per_metre, colour, max(1, thickness - 1))


def _stroke(image: Image, u: FloatArray, v: FloatArray, colour: Colour, thickness: int) -> None:
    """Draws the part of a curve that is in or near the image."""
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
    Unassigned."""
    top, height = places.panel
    width = places.picture[0]
    edges = np.linspace(12, width - 12, n_lanes + 2)
    sides = zip(np.rint(edges[:-1] + 4), np.rint(edges[1:] - 4), strict=True)
    return [(int(left), top + 26, int(right), top + height - 42) for left, right in sides]


def _bars(places: Layout, canvas: Image, scene: Scene) -> None:
    n_lanes = len(scene.belief)
    top, _ = places.panel
    boxes = bar_boxes(places, n_lanes)
    for k, (left, upper, right, lower) in enumerate(boxes):
        is_answer = scene.assigned == (k + 1 if k < n_lanes else UNASSIGNED)
        share = float(scene.belief[k]) if k < n_lanes else float(is_answer)
        height = round(share * (lower - upper))
        colour = OTHER if not is_answer else ASSIGNED if k < n_lanes else INK
        if height:
            cv2.rectangle(canvas, (left, lower - height), (right, lower), colour, -1)
        cv2.rectangle(canvas, (left, upper), (right, lower), FRAME, 1)
        name = f"lane {k + 1}" if k < n_lanes else "Unassigned"
        _centred(canvas, name, (left + right) // 2, lower + 15, right - left, INK)
        if k < n_lanes:
            text = f"{100 * share:.0f} %"
            _centred(canvas, text, (left + right) // 2, upper - 5, right - left, INK)
            if scene.truth == k + 1:
                cv2.rectangle(canvas, (left - 3, upper - 1), (right + 3, lower + 2), TRUTH, 2)
                _centred(canvas, "truth", (left + right) // 2, lower + 32, right - left, TRUTH)
    cv2.line(canvas, (0, top), (canvas.shape[1], top), FRAME, 1)


def _legend(places: Layout, canvas: Image, scene: Scene) -> None:
    left, top = places.picture[0] + 10, places.panel[0]
    answer = f"lane {scene.assigned}" if scene.assigned != UNASSIGNED else "Unassigned"
    rows: list[tuple[str, Colour | None]] = [
        (f"frame {scene.frame_id}, {scene.time_s:.1f} s", None),
        (f"answer: {answer}", None),
        ("valid, continuous", CONTINUOUS),
        ("valid, dashed or unknown", DASHED),
        ("not valid", NOT_VALID),
    ]
    for k, (text, colour) in enumerate(rows):
        start, baseline = left, top + 22 + k * ((places.panel[1] - 16) // len(rows))
        if colour is not None:
            start = left + 24
            cv2.rectangle(canvas, (left, baseline - 8), (left + 16, baseline), colour, -1)
        room = canvas.shape[1] - 6 - start
        _write(canvas, text, (start, baseline), min(TEXT, TEXT * room / _text_width(text)), INK)


def _text_width(text: str, scale: float = TEXT) -> int:
    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0])


def _centred(canvas: Image, text: str, middle: int, row: int, room: int, colour: Colour) -> None:
    scale = min(TEXT, TEXT * room / _text_width(text))
    _write(canvas, text, (middle - _text_width(text, scale) // 2, row), scale, colour)


def _write(image: Image, text: str, at: tuple[int, int], scale: float, colour: Colour) -> None:
    font: Any = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(image, text, at, font, scale, colour, 1, cv2.LINE_AA)
