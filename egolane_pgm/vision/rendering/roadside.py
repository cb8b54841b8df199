"""Draws what stands beside the rendered road: a concrete barrier on the left, a guard rail and
trees on the right, bridges across the road, hills behind it.

at_m is a place beside the car, metres to the right.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.rendering.strokes import Colour, View, band, fill, hazed

#: The slopes of the barrier (a New Jersey profile): lower and upper height, metres, and colour.
_BARRIER: tuple[tuple[float, float, Colour], ...] = (
    (0.0, 0.08, (150, 152, 155)),
    (0.08, 0.33, (176, 179, 182)),
    (0.33, 0.9, (156, 159, 163)),
    (0.9, 0.96, (190, 194, 198)),
)

#: The height of the barrier, metres.
BARRIER_M = 0.96

_AHEAD = 1 / np.linspace(1 / 1.2, 1 / 200.0, 28)


def _every(step_m: float, s0: float, far_m: float) -> FloatArray:
    """Metres ahead of all multiples of step_m along the road, from 1.3 m to far_m ahead."""
    return np.arange(np.ceil((s0 + 1.3) / step_m) * step_m, s0 + far_m, step_m) - s0


def draw_barrier(view: View, at_m: float) -> None:
    """Draws the concrete barrier, with joints every 6 m."""
    y = at_m + view.side(_AHEAD)
    near, far = slice(0, 23), slice(22, None)
    for low, high, colour in _BARRIER:
        band(view, _AHEAD[far], y[far], low, high, hazed(colour, 90.0))
        band(view, _AHEAD[near], y[near], low, high, hazed(colour, 10.0))
    for x in _every(6.0, view.s0, 45.0):
        both = np.array([x, x + 0.04])
        band(view, both, at_m + view.side(both), 0.0, BARRIER_M, (96, 98, 100))


def draw_rail(view: View, at_m: float) -> None:
    """Draws the guard rail, with posts every 4 m."""
    for x in _every(4.0, view.s0, 60.0):
        both = np.array([x, x + 0.12])
        band(view, both, at_m + 0.1 + view.side(both), 0.0, 0.7, (88, 90, 92))
    y = at_m + view.side(_AHEAD)
    for low, high, colour in (
        (0.44, 0.54, (150, 152, 152)),
        (0.54, 0.63, (112, 114, 116)),
        (0.63, 0.74, (178, 180, 180)),
    ):
        band(view, _AHEAD, y, low, high, hazed(colour, 25.0))


def draw_trees(view: View, at_m: float, tree_s_m: FloatArray) -> None:
    """Draws trees, most of them some metres right of at_m, some beyond the other carriageway.

    tree_s_m: their places along the road, from which size, side and colour follow.
    """
    angle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    first, last = np.searchsorted(tree_s_m, (view.s0 + 6.0, view.s0 + 240.0))
    for s in tree_s_m[first:last][::-1]:
        x = np.array([s - view.s0])
        look = np.modf(np.array([s * 0.731, s * 1.137, s * 2.414]))[0]
        left = look[2] < 0.3
        y = view.side(x) + (-26.0 - 9 * look[0] if left else at_m + 4.0 + 8.0 * look[0])
        tall = 4.0 + 5.0 * look[1]
        foot_u, foot_v = view.project(x, y, np.zeros(1))
        _, top_v = view.project(x, y, np.array([tall]))
        size = float((foot_v - top_v)[0])
        if not np.isfinite(size) or size < 2 or abs(float(foot_u[0])) > 4 * view.image.shape[1]:
            continue
        trunk = 0.03 * size * np.array([-1.0, 1.0, 1.0, -1.0])
        up = foot_v - size * np.array([0.0, 0.0, 0.5, 0.5])
        fill(view.image, foot_u + trunk, up, hazed((42, 52, 60), float(x[0])))
        for dx, dz, radius, tone in (
            (-0.1, 0.5, 0.26, 0.8),
            (0.12, 0.55, 0.26, 0.9),
            (0.0, 0.72, 0.27, 1.0),
        ):
            ragged = radius * size * (1 + 0.12 * np.sin(5 * angle + 40 * look[0]))
            u = foot_u + dx * size + ragged * np.cos(angle)
            v = foot_v - dz * size + ragged * np.sin(angle)
            green = (34 * tone, (66 + 20 * look[2]) * tone, 46 * tone)
            fill(view.image, u, v, hazed(green, float(x[0])))


def draw_hills(image: Image, horizon: float, turn_px: float, first: int) -> None:
    """Draws two ranges of hills above row `first`, moved to the left by turn_px."""
    u = np.linspace(0, image.shape[1] - 1, 80)
    around = np.concatenate([u, u[::-1]])
    for height, wave, colour in ((26.0, 260.0, (192, 178, 160)), (15.0, 140.0, (150, 150, 132))):
        at = (u + turn_px) / wave
        top = height * (
            0.75 + 0.3 * np.sin(at) + 0.2 * np.sin(2.3 * at + 1) + 0.1 * np.sin(5.1 * at)
        )
        fill(image, around, np.concatenate([horizon - top, np.full(80, float(first))]), colour)


def draw_bridge(view: View, x_m: float) -> None:
    """Draws a bridge across the road x_m ahead: its face, and a pier on either side."""
    at = np.array([x_m, x_m])
    middle = view.side(at)
    for low, high, tone in ((5.3, 7.0, 138.0), (7.0, 8.1, 172.0)):
        across = middle + np.array([-45.0, 45.0])
        band(view, at, across, low, high, hazed((tone, tone, tone), x_m))
    for place in (-2.2, 24.0):
        y = middle + np.array([place, place + 1.0])
        band(view, at, y, 0.0, 5.3, hazed((120, 122, 124), x_m))
