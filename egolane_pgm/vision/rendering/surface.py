"""Draws the ground of the rendered world: asphalt, concrete, grass, and the shadows on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.rendering.road import Floats, blurred, ranked

#: The tile of the road's surface: metres per pixel along and across, its length, its left edge.
ALONG_M, ACROSS_M = 0.0625, 0.03
TILE_M = 64.0
LEFT_M = -14.0

#: The tile of the asphalt's grain: metres per pixel along and across, and its size in pixels. Then
#: bands of picture rows in which it is visible: metres of road per row up to which a band goes, and
#: the strength of the grain in it.
_GRAIN_ALONG_M, _GRAIN_ACROSS_M, _GRAINS = 0.02, 0.006, 512
_GRAIN_BANDS = ((0.03, 1.0), (0.06, 0.75), (0.12, 0.5), (0.25, 0.25))

#: The tile of the shadows of leaves: metres per pixel, and its size in pixels.
_LEAF_M, _LEAVES = 0.1, 512

#: The share of light that is left in a shadow.
DARK = 0.42


@dataclass(frozen=True)
class Surface:
    """The road's surface, and the light on it.

    - tiles: (rows along + 1, columns across, 3) each, from sharp to blurred along the road; tile k
      is for picture rows that cover up to footprint_m[k] metres of road
    - grain_tile: the asphalt's grain, around 128
    - grid_m: (G,) places along the road at which the following are given
    - concrete: (G,) 1 on concrete, else 0
    - bridge: (G,) 1 in the shadow of a bridge, else 0
    - bridge_m: where each bridge begins
    - reach_m: (G,) how far to the right of the barrier its shadow falls; 0 for none
    - leaves: (G,) share of the road's right edge that is in the shadow of trees
    - leaf_tile: pattern of that shadow, in [0, 1]
    - barrier_m, right_m, rail_m: d of the barrier, of the rightmost line, of the asphalt's end
    """

    tiles: list[Image]
    grain_tile: Image
    footprint_m: FloatArray
    grid_m: FloatArray
    concrete: FloatArray
    bridge: FloatArray
    bridge_m: FloatArray
    reach_m: FloatArray
    leaves: FloatArray
    leaf_tile: Floats
    barrier_m: float
    right_m: float
    rail_m: float

    def shadow(self, s: FloatArray, d: FloatArray) -> FloatArray | Floats:
        """How deep in shadow, 0 to 1, the road is at s and d, which broadcast."""
        deep = np.interp(s, self.grid_m, self.bridge).astype(np.float32)
        reach = np.interp(s, self.grid_m, self.reach_m).astype(np.float32)
        if reach.max(initial=0) > 0:
            edge = np.clip((self.barrier_m + reach - d) / 0.08 + 0.5, 0, 1)
            deep = np.maximum(deep, edge * (reach > 0) * (d > self.barrier_m))
        leaves = np.interp(s, self.grid_m, self.leaves).astype(np.float32)
        if leaves.max(initial=0) > 0:
            # Trees stand on the right, so their shadows thin out to the left.
            share = leaves * np.clip((d + 6.0) / (self.right_m + 6.0), 0.15, 1.0)
            deep = np.maximum(deep, np.clip((share - self._leaf(s, d)) / 0.12, 0, 1))
        return np.asarray(np.broadcast_to(deep, np.broadcast_shapes(s.shape, d.shape)))

    def _leaf(self, s: FloatArray, d: FloatArray) -> Floats:
        along, across = (s / _LEAF_M).astype(np.float64) % _LEAVES, (d / _LEAF_M) % _LEAVES
        return np.asarray(_sampled(self.leaf_tile, across, along, cv2.BORDER_WRAP))


def _sampled(tile: NDArray[Any], across: FloatArray, along: FloatArray, border: int) -> Any:
    """A tile at columns `across` and rows `along`, which broadcast; border: of `cv2.remap`."""
    columns, rows = map(np.ascontiguousarray, np.broadcast_arrays(across, along))
    maps = columns.astype(np.float32), rows.astype(np.float32)
    found = cv2.remap(tile, *maps, cv2.INTER_LINEAR, borderMode=border)
    return found.reshape(columns.shape + tile.shape[2:])


def make_tiles(
    rng: np.random.Generator, line_d_m: FloatArray, barrier_m: float, rail_m: float
) -> tuple[list[Image], FloatArray]:
    """Draws the tiles of the surface; gives them with their footprints.

    - line_d_m: (L,) the lines; between them wheels have left tracks
    - barrier_m, rail_m: left and right end of the asphalt
    """
    rows = int(TILE_M / ALONG_M)
    d = np.arange(LEFT_M, rail_m + 12.0, ACROSS_M)
    shape = (rows, len(d))
    noise = rng.standard_normal(shape)
    grain = 3.5 * blurred(noise, 0.6, 0.6)
    grain += 2.0 * blurred(rng.standard_normal(shape), 12.0, 3.0)
    coarse = cv2.resize(
        blurred(rng.standard_normal((rows // 16, len(d) // 16)), 3.0, 2.0), shape[::-1]
    )
    grey = 96.0 + grain + 3.0 * coarse
    centres = (line_d_m[1:] + line_d_m[:-1]) / 2
    for centre in centres:
        for wheel in (-0.9, 0.9):
            grey -= 5.0 * np.exp(-0.5 * ((d - centre - wheel) / 0.25) ** 2)
        grey -= 7.0 * np.exp(-0.5 * ((d - centre) / 0.2) ** 2)
    # Some lines have a paving seam beside them, dark with bitumen, or light where it is open.
    for place in line_d_m[1:-1] + rng.uniform(0.15, 0.5, len(line_d_m) - 2):
        grey += rng.choice([-22.0, -14.0, 10.0]) * np.exp(-0.5 * ((d - place) / 0.03) ** 2)
    _patch(grey, rng, d, barrier_m, rail_m)
    tint = np.array([1.02, 1.0, 0.97])
    ground = grey[..., None] * tint
    grass = np.array([52.0, 96.0, 84.0]) + 2.2 * grain[..., None] + 6.0 * coarse[..., None]
    is_grass = (d > rail_m + 0.4) | (d < LEFT_M + 0.5)
    ground = np.where(is_grass[:, None], grass, ground)
    sharp = np.clip(ground, 0, 255).astype(np.uint8)
    footprint = np.array([ALONG_M * 3.0**k for k in range(5)])
    tiles: list[Image] = []
    for k, metres in enumerate(footprint):
        tile = sharp
        if k:
            length = 2 * round(metres / ALONG_M / 2) + 1
            wide = np.concatenate([sharp[-length:], sharp, sharp[:length]])
            tile = cv2.blur(wide, (min(2 * k - 1, 5), length))[length : length + rows]
        tiles.append(np.concatenate([tile, tile[:1]]).astype(np.uint8))
    return tiles, footprint


def _patch(
    grey: FloatArray, rng: np.random.Generator, d: FloatArray, left: float, right: float
) -> None:
    """Draws repairs, tar along cracks, and cross joints into the tile."""
    rows = len(grey)
    road = np.flatnonzero((d > left) & (d < right))
    for _ in range(8):
        length, wide = int(rng.uniform(2, 14) / ALONG_M), int(rng.uniform(0.5, 3) / ACROSS_M)
        low, left_end = rng.integers(0, rows - length), rng.integers(road[0], road[-1] - wide)
        grey[low : low + length, left_end : left_end + wide] += rng.choice([-16.0, -10.0, 9.0])
    for _ in range(6):
        steps = int(rng.uniform(30, 160))
        c = rng.uniform(road[0], road[-1]) + np.cumsum(rng.normal(0, 1.1, steps))
        r = rng.integers(0, rows) + np.arange(steps)
        path = np.stack([np.clip(c, 0, len(d) - 1), np.clip(r, 0, rows - 1)], 1)
        line = np.zeros(grey.shape, dtype=np.uint8)
        cv2.polylines(line, [path.astype(np.int32)], False, 255, 1, cv2.LINE_AA)
        grey -= 28.0 * (line / 255.0)
    for joint in rng.integers(0, rows - 2, 2):
        grey[joint, road] -= 18.0


def make_surface(
    rng: np.random.Generator,
    grid_m: FloatArray,
    level: FloatArray,
    line_d_m: FloatArray,
    barrier_m: float,
    rail_m: float,
) -> Surface:
    """Makes the surface of a road. level: (G,) how much shadow there is at grid_m, 0 to 1."""
    tiles, footprint = make_tiles(rng, line_d_m, barrier_m, rail_m)
    step = float(grid_m[1] - grid_m[0])
    smooth = blurred(rng.standard_normal((len(grid_m), 1)), 120.0 / step, 0)[:, 0]
    detail = blurred(rng.standard_normal((len(grid_m), 1)), 15.0 / step, 0)[:, 0]
    # As the road turns, the sun stands on the side of the barrier or on that of the trees.
    reach = np.where(smooth > 0, level * (2.6 + 0.35 * detail), 0.0)
    reach = np.where(reach > 0.15, reach, 0.0)
    leaves = np.where(smooth < 0, np.clip(level * (0.8 + 0.25 * detail), 0, 0.9), 0.0)
    bridge = np.zeros(len(grid_m))
    concrete = np.zeros(len(grid_m))
    bridges = np.flatnonzero(rng.random(len(grid_m)) < 0.003 * step * level)
    for k in bridges:
        bridge[k : k + int(rng.uniform(9, 16) / step)] = 1.0
    for k in np.flatnonzero(rng.random(len(grid_m)) < step / 2500.0):
        concrete[k : k + int(rng.uniform(80, 300) / step)] = 1.0
    tile = blurred(rng.standard_normal((_LEAVES, _LEAVES)), 9.0, 9.0)
    tile = tile + 0.8 * blurred(rng.standard_normal((_LEAVES, _LEAVES)), 2.5, 2.5)
    tile = tile + 0.6 * blurred(rng.standard_normal((_LEAVES, _LEAVES)), 0.9, 0.9)
    grain = 9.0 * rng.standard_normal((_GRAINS, _GRAINS, 1)) * np.ones(3)
    return Surface(
        tiles,
        np.clip(128 + grain, 0, 255).astype(np.uint8),
        footprint,
        grid_m,
        concrete,
        bridge,
        grid_m[bridges],
        reach,
        leaves,
        ranked(tile),
        barrier_m,
        float(line_d_m[-1]),
        rail_m,
    )


def draw_ground(
    image: Image, surface: Surface, first_row: int, s: FloatArray, d: FloatArray
) -> None:
    """Draws the surface into the picture's rows from first_row on.

    s, d: road coordinates of each pixel, (rows, columns); s may be (rows, 1).
    """
    rows = slice(first_row, None)
    along, across = (s % TILE_M) / ALONG_M, (d - LEFT_M) / ACROSS_M
    footprint = np.abs(np.gradient(s[:, 0]))
    tile = np.searchsorted(surface.footprint_m * 1.7, footprint).clip(0, len(surface.tiles) - 1)
    into = image[rows]
    for k in np.unique(tile):
        band = np.flatnonzero(tile == k)
        part = slice(int(band[0]), int(band[-1]) + 1)
        tile_k = surface.tiles[k]
        into[part] = _sampled(tile_k, across[part], along[part], cv2.BORDER_REPLICATE)
    _draw_grain(into, surface, s, d, footprint)
    concrete = np.interp(s[:, 0], surface.grid_m, surface.concrete)
    if concrete.max() > 0:
        some = np.flatnonzero(concrete > 0)
        part = slice(int(some[0]), int(some[-1]) + 1)
        joint = np.clip(1 - np.abs((s[part, 0] + 2.5) % 5.0 - 2.5) / 0.06, 0, 1)
        more = (concrete[part] * (0.55 - 0.35 * joint)).astype(np.float32)
        gain = 1 + more[:, None] * (d[part] < surface.rail_m)
        into[part] = cv2.multiply(into[part], cv2.merge([gain, gain, gain]), dtype=cv2.CV_8U)


def _draw_grain(
    into: Image, surface: Surface, s: FloatArray, d: FloatArray, footprint: FloatArray
) -> None:
    low = 0.0
    for high, gain in _GRAIN_BANDS:
        band = np.flatnonzero((footprint > low) & (footprint <= high))
        low = high
        if not band.size:
            continue
        part = slice(int(band[0]), int(band[-1]) + 1)
        along = (s[part] / _GRAIN_ALONG_M) % _GRAINS
        across = (d[part] / _GRAIN_ACROSS_M) % _GRAINS
        seen = _sampled(surface.grain_tile, across, along, cv2.BORDER_WRAP)
        into[part] = cv2.addWeighted(into[part], 1.0, seen, gain, -128.0 * gain)


def shade(image: Image, surface: Surface, first_row: int, s: FloatArray, d: FloatArray) -> None:
    """Darkens the picture's rows from first_row on where the road is in shadow."""
    deep = np.asarray(surface.shadow(s, d), dtype=np.float32)
    if deep.max(initial=0) > 0:
        into = image[first_row:]
        gain = 1 - (1 - DARK) * deep
        # Skylight is bluer than the sun.
        gains = cv2.merge([np.minimum(1, gain * 1.06), gain, gain * 0.97])
        into[:] = cv2.multiply(into, gains, dtype=cv2.CV_8U)
