"""Pictures of chessboards, and labelled lines of roads, as a known camera sees them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st

from egolane_pgm.vision.calibration.road_lines import fit_frame, to_level, view_from
from egolane_pgm.vision.camera.model import (
    Camera,
    image_to_road,
    level_rays,
    road_to_image,
    undistorted,
    vanishing_point,
)

LENS = (-0.25, 0.02, -0.0006, 0.0002, 0.0)
TRUE = Camera(
    1280, 720, 1100.0, 1095.0, 650.0, 370.0, height_m=1.4, pitch_deg=-2.0, yaw_deg=1.0,
    distortion=LENS,
)  # fmt: skip

cameras = st.builds(
    Camera,
    st.just(1280),
    st.just(720),
    st.floats(900, 1300),
    st.floats(900, 1300),
    st.floats(600, 700),
    st.floats(330, 400),
    height_m=st.floats(1.0, 2.8),
    pitch_deg=st.floats(-4, 3),
    yaw_deg=st.floats(-4, 4),
    roll_deg=st.floats(-3, 3),
    distortion=st.sampled_from([(0.0,) * 5, LENS]),
)


def unturned(camera: Camera) -> Camera:
    """What is known before the road is looked at: lens and roll."""
    return replace(camera, height_m=1.0, pitch_deg=0.0, yaw_deg=0.0)


def lines_of(camera: Camera, offsets, heading=0.0, curvature=0.0, noise=0.0, seed=0):
    """The points of parallel lines, pixels, as somebody would label them."""
    x = np.geomspace(5, 60, 60)
    rng = np.random.default_rng(seed)
    lines = []
    for offset in offsets:
        y = offset + heading * x + curvature * x**2 / 2
        points = np.stack(road_to_image(camera, x, y), axis=-1)
        points += rng.normal(0, noise, points.shape)
        inside = (points >= 0).all(axis=1) & (points < (camera.width, camera.height)).all(axis=1)
        lines.append(points[inside])
    return lines


def view_of_lines(true: Camera, camera: Camera, frames, lane_width_m=3.6):
    """How a camera, of which lens and roll are known, looks at the road of some frames of lines, as
    the true one sees them."""
    about = level_rays(camera, *vanishing_point(true))[1]
    fits = [
        fit
        for lines in frames
        if (fit := fit_frame([to_level(camera, *line.T) for line in lines], about)) is not None
    ]
    each = np.stack([fit.vanishing_point for fit in fits])
    known = replace(camera, lane_width_m=lane_width_m)
    return view_from(known, np.median(each, axis=0), each, fits)


@cache
def _rays(camera: Camera):
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    u, v = undistorted(camera, u, v)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0 * u + 1], -1)


def draw_board(camera: Camera, turn, place):
    """A chessboard of 9x6 inner corners, 30 mm squares, seen through a lens."""
    rays = _rays(camera)
    rotation = cv2.Rodrigues(np.array(turn, dtype=np.float64))[0]
    normal = rotation[:, 2]
    where = rays * ((normal @ place) / (rays @ normal))[..., None] - place
    column, row = (where @ rotation[:, i] / 0.03 + n / 2 for i, n in ((0, 10), (1, 7)))
    dark = (np.floor(column) + np.floor(row)) % 2 == 0
    board = (column >= 0) & (column < 10) & (row >= 0) & (row < 7)
    grey = np.where(board & dark, 40, 220).astype(np.uint8)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.8), cv2.COLOR_GRAY2BGR)


@cache
def _road(camera: Camera):
    """The place on the road of each pixel."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return image_to_road(camera, u, v)


def draw_road(camera: Camera, offsets, heading=0.0, seed=0):
    """A grey road with bright markings, dashed but for the outer ones, under a dark sky."""
    x, y = _road(camera)
    paint = np.zeros(x.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        for k, offset in enumerate(offsets):
            solid = k in (0, len(offsets) - 1)
            on = np.abs(y - offset - heading * x) < 0.08
            paint |= on & (x < 80) & (solid | ((x + 3 * seed) % 12 < 5))
    grey = np.where(np.isfinite(x), 90.0, 40.0) + np.random.default_rng(seed).normal(0, 3, x.shape)
    grey = np.clip(np.where(paint, 210.0, grey), 0, 255).astype(np.uint8)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.7), cv2.COLOR_GRAY2BGR)


def write_boards(folder: Path) -> Path:
    rng = np.random.default_rng(3)
    for k in range(10):
        turn = rng.uniform(-0.5, 0.5, 3)
        place = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.04, 0.04), 0.42])
        cv2.imwrite(str(folder / f"{k}.png"), draw_board(TRUE, turn, place))
    return folder


def write_stills(folder: Path) -> Path:
    for k, shift in enumerate((0.0, 0.3, -0.4)):
        offsets = np.array([-5.55, -1.85, 1.85, 5.55]) + shift
        cv2.imwrite(str(folder / f"{k}.png"), draw_road(TRUE, offsets, 0.004 * (k - 1), k))
    return folder
