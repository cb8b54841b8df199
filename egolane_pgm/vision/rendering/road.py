"""The course of the rendered road, and its lines: their dashes and how worn they are.

Road coordinates are in metres: s along the road, d to the right of the leftmost line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.simulation._common import Positive, check_fields
from egolane_pgm.types import BoolArray, FloatArray, InputError

Floats = NDArray[np.float32]

#: The tile of wear: metres per pixel along a line, and pixels across a line's width.
_WEAR_STEP_M = 0.05
_WEAR_ACROSS = 8


@dataclass(frozen=True)
class Markings:
    """The markings of a road: dashed lines between lanes, continuous lines at both edges.

    - dash_m, gap_m: lengths of a dash and of the gap after it
    - lane_line_m, edge_line_m: widths of a line between lanes and of one at an edge

    Raises InputError, naming the key, for a value that is not positive.
    """

    dash_m: Positive
    gap_m: Positive
    lane_line_m: Positive
    edge_line_m: Positive

    def __post_init__(self) -> None:
        check_fields(self)
        if max(self.lane_line_m, self.edge_line_m) > 1:
            raise InputError("simulation.lane_line_m: a line is at most 1 m wide")


#: Motorways with a design speed above 110 km/h, least values: dashes and width of lane lines by
#: D.P.R. 495/1992 art. 138 (type a), width of edge lines by art. 141.
ITALIAN = Markings(dash_m=4.5, gap_m=7.5, lane_line_m=0.15, edge_line_m=0.25)

#: Roads of more than 100 km/h: Norma 8.2-IC (1987), mark M-1.1 (5 m, gaps of 12 m, .10 m wide);
#: edge lines taken as .20 m.
SPANISH = Markings(dash_m=5.0, gap_m=12.0, lane_line_m=0.10, edge_line_m=0.20)


@dataclass(frozen=True)
class Course:
    """A road of clothoids: the curvature is linear in s between N nodes.

    - s_m: (N,) the nodes
    - curvature: (N,) 1/m, positive to the right
    - heading, side_m: (N,) the first and second integral of the curvature
    """

    s_m: FloatArray
    curvature: FloatArray
    heading: FloatArray
    side_m: FloatArray

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Side, heading, curvature and its rate at s (any shape)."""
        k = np.clip(np.searchsorted(self.s_m, s, side="right") - 1, 0, len(self.s_m) - 2)
        u = s - self.s_m[k]
        slope = (self.curvature[k + 1] - self.curvature[k]) / (self.s_m[k + 1] - self.s_m[k])
        bend = self.curvature[k]
        side = self.side_m[k] + u * (self.heading[k] + u * (bend / 2 + u * slope / 6))
        return side, self.heading[k] + u * (bend + u * slope / 2), bend + u * slope, slope

    def bend(self, s0: float, x: FloatArray) -> FloatArray:
        """How far to the right the road bends from s0 to x metres after it, metres."""
        here = np.array(s0)
        side, heading, _, _ = self.at(here)
        return np.asarray(self.at(s0 + x)[0] - side - heading * x)


def make_course(rng: np.random.Generator, length_m: float, curvature: float) -> Course:
    """Draws a random course of straights, clothoids and arcs; `curvature` (1/m) is the largest."""
    n_nodes = int(length_m / 200) + 4
    s_m = -100.0 + np.concatenate([[0.0], np.cumsum(rng.uniform(150, 450, n_nodes))])
    target = curvature * rng.uniform(-1, 1, n_nodes + 1) * (rng.random(n_nodes + 1) < 0.7)
    # Every second piece has constant curvature (straight or arc); clothoids connect them.
    bends = np.repeat(target, 2)[: n_nodes + 1]
    step = np.diff(s_m)
    slope = np.diff(bends) / step
    heading = np.concatenate([[0.0], np.cumsum(bends[:-1] * step + slope * step**2 / 2)])
    sides = heading[:-1] * step + bends[:-1] * step**2 / 2 + slope * step**3 / 6
    return Course(s_m, bends, heading, np.concatenate([[0.0], np.cumsum(sides)]))


@dataclass(frozen=True)
class Lines:
    """The L = n + 1 lines of the road, from left to right.

    - d_m, width_m: (L,) place and width
    - phase_m: (L,) an s at which a dash begins
    - is_continuous: (L,)
    - dash_m, period_m: length of a dash, and distance from one to the next
    - wear_offset_m: (L,) where in the tile of wear a line begins
    - wear_tile: (rows along, columns across), uniformly distributed in [0, 1]; the paint is gone
      where the tile is below the level of wear
    """

    d_m: FloatArray
    width_m: FloatArray
    phase_m: FloatArray
    is_continuous: BoolArray
    dash_m: float
    period_m: float
    wear_offset_m: FloatArray
    wear_tile: Floats

    def __len__(self) -> int:
        return len(self.d_m)

    def is_dash(self, line: int, s: FloatArray) -> BoolArray:
        """Whether the dash pattern of a line has paint at s."""
        if self.is_continuous[line]:
            return np.ones(np.shape(s), dtype=bool)
        return np.asarray((s - self.phase_m[line]) % self.period_m < self.dash_m)

    def dash_share(self, line: int, near: FloatArray, far: FloatArray) -> FloatArray:
        """The share of a line between `near` and `far` that its dash pattern paints."""
        if self.is_continuous[line]:
            return np.ones(np.shape(near))
        painted = [
            np.floor(s / self.period_m) * self.dash_m
            + np.minimum(s - np.floor(s / self.period_m) * self.period_m, self.dash_m)
            for s in (near - self.phase_m[line], far - self.phase_m[line])
        ]
        return np.asarray((painted[1] - painted[0]) / np.maximum(far - near, 1e-9))

    def paint(self, line: int, s: FloatArray, across: FloatArray, wear: FloatArray) -> FloatArray:
        """How much paint is left, 0 to 1, after wear. The arguments broadcast.

        - s: metres along the road
        - across: place in the line, from 0 at its left edge to 1
        - wear: level of wear, 0 to 1
        """
        along = ((s + self.wear_offset_m[line]) / _WEAR_STEP_M).astype(np.int64)
        column = np.clip((across * _WEAR_ACROSS).astype(np.int64), 0, _WEAR_ACROSS - 1)
        tile = self.wear_tile[along % len(self.wear_tile), column]
        left = np.clip((tile - wear) / 0.08 + 0.5, 0.0, 1.0)
        return np.asarray(np.where(wear <= 0, 1.0, np.where(wear >= 1, 0.0, left)))


def make_lines(
    rng: np.random.Generator, n_lanes: int, lane_width_m: float, markings: Markings
) -> Lines:
    """Makes the lines of a road; the leftmost one is at d = 0."""
    n_lines = n_lanes + 1
    is_edge = np.isin(np.arange(n_lines), (0, n_lanes))
    period = markings.dash_m + markings.gap_m
    rows = 4096
    tile = np.zeros((rows, _WEAR_ACROSS), dtype=np.float32)
    for weight, along, across in ((0.8, 0.08, 0.0), (1.0, 0.35, 1.0), (1.0, 2.5, 4.0)):
        noise = rng.standard_normal(tile.shape)
        tile += weight * blurred(noise, along / _WEAR_STEP_M, across)
    return Lines(
        d_m=np.arange(n_lines, dtype=np.float64) * lane_width_m,
        width_m=np.where(is_edge, markings.edge_line_m, markings.lane_line_m),
        phase_m=rng.uniform(0, period, n_lines),
        is_continuous=is_edge,
        dash_m=markings.dash_m,
        period_m=period,
        wear_offset_m=rng.uniform(0, rows * _WEAR_STEP_M, n_lines),
        wear_tile=ranked(tile),
    )


def blurred(noise: FloatArray, along: float, across: float) -> Floats:
    """Smooths periodic noise with a Gaussian, and scales it to mean 0 and standard deviation 1.

    along, across: standard deviations of the Gaussian, pixels.
    """
    height, width = noise.shape
    pad = [(min(height, int(4 * along) + 1),) * 2, (min(width, int(4 * across) + 1),) * 2]
    wide: NDArray[Any] = np.pad(noise.astype(np.float32), pad, mode="wrap")
    if along > 0:
        wide = cv2.GaussianBlur(wide, (1, 2 * pad[0][0] + 1), sigmaX=0.1, sigmaY=along)
    if across > 0:
        wide = cv2.GaussianBlur(wide, (2 * pad[1][0] + 1, 1), sigmaX=across, sigmaY=0.1)
    tile = wide[pad[0][0] : pad[0][0] + height, pad[1][0] : pad[1][0] + width]
    return np.asarray((tile - tile.mean()) / tile.std(), dtype=np.float32)


def ranked(tile: Floats) -> Floats:
    """The ranks of a tile's values, as shares: uniformly distributed in [0, 1)."""
    ranks = np.argsort(np.argsort(tile.ravel())) / tile.size
    return ranks.reshape(tile.shape).astype(np.float32)


def draw_lines(
    image: NDArray[np.uint8],
    lines: Lines,
    edges: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]],
    wear: FloatArray,
    wear_s: FloatArray,
    colour: tuple[float, float, float],
) -> None:
    """Draws the lines into the picture, row by row; each pixel gets as much paint as it shows line.

    - edges: for each line, five arrays over the rows that it crosses: the row, the columns of the
      line's left and right edge in it, and s at the row's lower and upper border
    - wear: level of wear at the places wear_s along the road
    - colour: of new paint, blue green red
    """
    width = image.shape[1]
    for line, (rows, left, right, near, far) in enumerate(edges):
        middle = (near + far) / 2
        share = lines.dash_share(line, near, far)
        level = np.interp(middle, wear_s, wear)
        # Single holes in the paint blur where a row covers metres of road.
        blend = np.clip((far - near) / 1.0, 0, 1)
        for part in _alike(right - left):
            part = part[(share[part] > 0) & (right[part] > 0) & (left[part] < width - 1)]
            if not part.size:
                continue
            span = int(np.ceil((right - left)[part].max())) + 2
            columns = np.floor(left[part] + 0.5).astype(np.int64)[:, None] + np.arange(span)
            low = columns - 0.5
            cover = np.clip(right[part, None] - low, 0, 1) - np.clip(left[part, None] - low, 0, 1)
            across = (columns - left[part, None]) / (right - left)[part, None]
            lvl = level[part, None]
            left_over = lines.paint(line, middle[part, None], across, lvl)
            mix = blend[part, None]
            left_over = (1 - mix) * left_over + mix * (1 - lvl)
            # The paint that is left is also thinner where it is worn.
            alpha = cover * share[part, None] * left_over * (1 - 0.4 * lvl)
            inside = (columns >= 0) & (columns < width) & (alpha > 0.004)
            at_row = np.broadcast_to(rows[part, None], columns.shape)[inside]
            at_column, a = columns[inside], alpha[inside, None]
            under = image[at_row, at_column]
            image[at_row, at_column] = (under + a * (np.array(colour) - under) + 0.5).astype(
                np.uint8
            )


def _alike(width: FloatArray) -> list[NDArray[np.int64]]:
    """Groups of rows in which a line has a similar width, so that windows stay small."""
    groups = np.digitize(width, [3.0, 8.0, 20.0])
    return [np.flatnonzero(groups == g) for g in range(4)]
