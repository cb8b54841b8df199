"""Renders the pictures of a simulated drive, with their exact truth.

    scene = make_scene("a4", seed=0, frames=3000)
    frame = render_frame(scene, 1234)      # .image, .right (of a stereo camera), .truth
    truth = frame_truth(scene, 1234)       # the same truth, without the picture

Any frame can be rendered without those before it. The same arguments give the same pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog
from egolane_pgm.vision.camera.model import Camera, axes, matrix, road_to_image
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.rendering import road as roads
from egolane_pgm.vision.rendering import roadside
from egolane_pgm.vision.rendering import surface as surfaces
from egolane_pgm.vision.rendering import traffic as traffics
from egolane_pgm.vision.rendering.scene import Scene
from egolane_pgm.vision.rendering.strokes import HAZE, Project, View

#: The farthest road that is drawn, metres ahead; haze begins there.
_FAR_M = 350.0

#: The points at which the visibility of a line is judged, metres ahead.
_SEEN_M = np.linspace(6.0, 25.0, 153)


@dataclass(frozen=True)
class FrameTruth:
    """The truth of a frame with L = n + 1 lines, from left to right.

    - lane, is_crossing: as annotated
    - is_failing: whether the frame is in a burst of failures
    - camera: with the pitch of this frame
    - shape: (L, 4) coefficients of y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6, metres, near the
      car: offset, heading, curvature and its rate
    - is_continuous: (L,)
    - visible, worn, hidden, shaded: (L,) shares of the marking between 6 and 25 m ahead that can be
      seen well, whose paint is gone, that is behind a vehicle or out of the picture, and that is
      in shadow
    """

    frame_id: int
    lane: int
    is_crossing: bool
    is_failing: bool
    camera: Camera
    shape: FloatArray
    is_continuous: BoolArray
    visible: FloatArray
    worn: FloatArray
    hidden: FloatArray
    shaded: FloatArray

    @property
    def offset_m(self) -> FloatArray:
        """The lines' offsets, (L,), metres, negative on the left."""
        return self.shape[:, 0]


@dataclass(frozen=True)
class Frame:
    """A rendered frame. image: (H, W, 3), blue green red; right: that of the second camera."""

    frame_id: int
    image: Image
    right: Image | None
    truth: FrameTruth


def _side(scene: Scene, k: int) -> Callable[[FloatArray], FloatArray]:
    """A function from x, metres ahead of the car in frame k, to how far right the road bends."""
    s0, heading = float(scene.s_m[k]), float(scene.heading[k])
    return lambda x: np.asarray(heading * x + scene.course.bend(s0, x))


def line_y(scene: Scene, k: int, x: FloatArray) -> FloatArray:
    """The places of the lines x metres ahead in frame k, metres to the right: (L, *x.shape)."""
    offsets = scene.road.line_offset_m[k].reshape(-1, *[1] * np.ndim(x))
    return np.asarray(offsets + _side(scene, k)(x))


def _boxes(scene: Scene, k: int) -> list[traffics.Box]:
    time_s = k / scene.road.frame_rate
    position = float(scene.road.position_m[k])
    return traffics.boxes(scene.traffic, time_s, position, _side(scene, k))


def frame_truth(scene: Scene, k: int) -> FrameTruth:
    """The truth of frame k. Raises InputError if there is no such frame."""
    if not 0 <= k < len(scene):
        raise InputError(f"simulation: frame {k} is outside 0..{len(scene) - 1}")
    camera, s0 = scene.camera, float(scene.s_m[k])
    camera = replace(camera, pitch_deg=float(camera.pitch_deg + scene.pitch_deg[k]))
    _, _, bend, rate = scene.course.at(np.array(s0))
    n_lines = len(scene.lines)
    shape = np.empty((n_lines, 4))
    shape[:, 0] = scene.road.line_offset_m[k]
    shape[:, 1:] = scene.heading[k], float(bend), float(rate)

    project = _projector(camera, np.zeros(3))
    mask = np.zeros((camera.height, camera.width), dtype=np.uint8)
    for box in _boxes(scene, k):
        u, v = traffics.hull(box, project)
        if len(u):
            cv2.fillConvexPoly(mask, np.round(np.stack([u, v], -1) * 16).astype(np.int32), 1, 8, 4)
    y = line_y(scene, k, _SEEN_M)
    u, v = road_to_image(camera, _SEEN_M, y)
    s = s0 + _SEEN_M
    wear = np.interp(s, scene.s_m, scene.level["wear"])
    shares = np.zeros((4, n_lines))
    for line in range(n_lines):
        on = scene.lines.is_dash(line, s)
        column, row = np.round(u[line]).astype(np.int64), np.round(v[line]).astype(np.int64)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        behind = mask[row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)] > 0
        across = np.array([0.125, 0.375, 0.625, 0.875])[:, None]
        gone = scene.lines.paint(line, s, across, wear).mean(axis=0) < 0.5
        dark = scene.surface.shadow(s, np.full_like(s, scene.lines.d_m[line])) > 0.5
        hidden = behind | ~inside
        good = ~(gone | dark | hidden)
        shares[:, line] = [
            float(part[on].mean()) if on.any() else 0.0 for part in (good, gone, hidden, dark)
        ]
    return FrameTruth(
        int(k),
        int(scene.road.lane[k]),
        bool(scene.road.is_crossing[k]),
        bool(scene.is_failing[k]),
        camera,
        shape,
        scene.lines.is_continuous.copy(),
        *shares,
    )


def render_frame(scene: Scene, k: int) -> Frame:
    """Renders frame k with its truth. Raises InputError if there is no such frame."""
    truth = frame_truth(scene, k)
    baseline = truth.camera.baseline_m
    left = _render(scene, truth, 0.0, 0)
    right = None if baseline is None else _render(scene, truth, baseline, 1)
    return Frame(truth.frame_id, left, right, truth)


def _render(scene: Scene, truth: FrameTruth, shift_m: float, which: int) -> Image:
    """The picture of camera number `which`, `shift_m` to the right of the first one."""
    camera, k = truth.camera, truth.frame_id
    to_camera = axes(camera)
    shift = shift_m * to_camera[0]
    s0, position = float(scene.s_m[k]), float(scene.road.position_m[k])

    project = _projector(camera, shift)
    image = np.empty((camera.height, camera.width, 3), dtype=np.uint8)
    horizon = camera.cy - camera.fy * to_camera[2, 2] / to_camera[1, 2]
    first = _sky(image, scene, horizon)

    # The road point of every pixel. Without roll, a row has one distance along the optical axis.
    b = (np.arange(first, camera.height) - camera.cy)[:, None] / camera.fy
    a = (np.arange(camera.width) - camera.cx)[None, :] / camera.fx
    reach = -camera.height_m / (b * to_camera[1, 2] + to_camera[2, 2])
    x = shift[0] + reach * (b * to_camera[1, 0] + to_camera[2, 0])
    if camera.yaw_deg:
        x = x + reach * a * to_camera[0, 0]
    y = (
        camera.lateral_m
        + shift[1]
        + reach * (a * to_camera[0, 1] + b * to_camera[1, 1] + to_camera[2, 1])
    )
    side = _side(scene, k)
    s, d = s0 + x, (y - side(x) + position).astype(np.float32)

    surfaces.draw_ground(image, scene.surface, first, s, d)
    edges = _edges(scene, k, project, first, camera)
    wear = scene.level["wear"]
    roads.draw_lines(image, scene.lines, edges, wear, scene.s_m, (206.0, 210.0, 212.0))
    surfaces.shade(image, scene.surface, first, s, d)
    haze = (1 - np.exp(-np.clip(x.mean(axis=1), 0, None) / 500.0))[:, None, None]
    far = int(np.searchsorted(-x.mean(axis=1), -40.0))
    mixed = image[first : first + far] * (1 - haze[:far]) + np.array(HAZE) * haze[:far]
    image[first : first + far] = mixed.astype(np.uint8)

    view = View(image, project, side, s0)
    turn = camera.fx * float(scene.heading[k] - scene.course.at(np.array(s0))[1])
    roadside.draw_hills(image, horizon, turn, first)
    for start in scene.surface.bridge_m[::-1] - s0:
        if 3.0 < start < 300.0:
            roadside.draw_bridge(view, float(start))
    rail = scene.rail_m - position
    roadside.draw_trees(view, rail, scene.tree_s_m)
    roadside.draw_barrier(view, scene.surface.barrier_m - position)
    roadside.draw_rail(view, rail)
    for box in _boxes(scene, k):
        middle = (
            np.array([[s0 + box.x[0] + 1.0]]),
            np.array([[position + box.y[0] - side(box.x[:1])[0]]]),
        )
        light = 1 - 0.45 * float(scene.surface.shadow(*middle)[0, 0])
        traffics.draw_box(view, box, light)
    return _finish(image, scene, k, which)


def _projector(camera: Camera, shift: FloatArray) -> Project:
    """A fast `road_to_image` for many small calls; the camera is moved by `shift` (x, y, z), m."""
    to_camera = axes(camera)
    position = shift + np.array([0.0, camera.lateral_m, camera.height_m])
    rows = (matrix(camera) @ np.column_stack([to_camera, -to_camera @ position])).tolist()

    def project(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        u, v, depth = (r[0] * x + r[1] * y + r[2] * z + r[3] for r in rows)
        depth = np.where(depth > 1e-9, depth, np.nan)
        return u / depth, v / depth

    return project


def _edges(
    scene: Scene, k: int, project: Project, first: int, camera: Camera
) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]]:
    """The `edges` of `draw_lines`: where the edges of each line cross the rows of the picture."""
    s0 = float(scene.s_m[k])
    x = 1 / np.linspace(1 / 1.2, 1 / _FAR_M, 600)
    y = line_y(scene, k, x)
    found = []
    for line, width in enumerate(scene.lines.width_m):
        sides = [project(x, y[line] + side * width / 2, np.zeros_like(x)) for side in (-1, 1)]
        v = (sides[0][1] + sides[1][1]) / 2
        rows = np.arange(first, camera.height)
        up = slice(None, None, -1)
        left, right = (np.interp(rows, side[1][up], side[0][up]) for side in sides)
        lower, upper = (1 / np.interp(rows + half, v[up], 1 / x[up]) for half in (0.5, -0.5))
        keep = (rows > v[-1] + 0.5) & (rows < v[0] - 0.5)
        found.append((rows[keep], left[keep], right[keep], s0 + lower[keep], s0 + upper[keep]))
    return found


def _sky(image: Image, scene: Scene, horizon: float) -> int:
    """Draws the sky and returns the first row below it."""
    camera = scene.camera
    first = math.ceil(horizon + camera.fy * camera.height_m / _FAR_M)
    first = min(max(first, 0), camera.height)
    up = np.clip((horizon - np.arange(first)) / camera.height, 0, 1)[:, None]
    top = np.array([214.0, 178.0, 140.0])
    image[:first] = (np.array(HAZE) + (top - np.array(HAZE)) * up * 1.6)[:, None].clip(0, 255)
    return first


def _finish(image: Image, scene: Scene, k: int, which: int) -> Image:
    """Adds the camera's own faults: glare, a soft lens, noise."""
    glare = float(scene.level["glare"][k])
    if glare > 0:
        lit = cv2.addWeighted(image, 1 - 0.45 * glare, scene.halo, 0.9 * glare, 0)
        image = np.asarray(lit, dtype=np.uint8)
    image = np.asarray(cv2.GaussianBlur(image, (3, 3), 0.6), dtype=np.uint8)
    rng = np.random.default_rng([scene.seed, 4, k, which])
    row, column = rng.integers(0, 128, 2)
    cut = scene.noise_tile[row : row + image.shape[0], column : column + image.shape[1]]
    gain = (1.0 + 10.0 * float(scene.level["noise"][k])) / 24.0
    return np.asarray(cv2.addWeighted(image, 1.0, cut, gain, -128.0 * gain), dtype=np.uint8)


def true_lines(scene: Scene) -> LineLog:
    """The lane lines as a perfect detector would report them: all of them in every frame."""
    offset = scene.road.line_offset_m
    frame_id = np.arange(len(scene), dtype=np.int64)
    return LineLog(
        frame_id,
        frame_id / scene.road.frame_rate,
        offset.copy(),
        np.ones(offset.shape, dtype=bool),
        np.tile(scene.lines.is_continuous, (len(scene), 1)),
        np.full(offset.shape, 10.0),
        source="rendered road",
    )
