"""Markings and seeds beside plain NumPy and Python versions of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from egolane_pgm.classic.multilane.markings import (
    EDGE,
    FILTER,
    edge_pairs,
    find_markings,
    seeds_of,
)
from egolane_pgm.classic.multilane.road import road_of
from egolane_pgm.types import FloatArray, runs_of
from egolane_pgm.vision.camera.model import image_to_road
from tests.kits.synthetic_road import CAMERA, THREE, road

LIMITS = (2.0, 9.0)


def blurred(seed: int, rows: int = 6, width: int = 90) -> NDArray[np.uint8]:
    """A picture with structures of all widths."""
    rng = np.random.default_rng(seed)
    wild = rng.normal(0, 60, (rows, width)).cumsum(axis=1)
    return np.clip(128 + wild - wild.mean(axis=1, keepdims=True), 0, 255).astype(np.uint8)


def pairs_by_numpy(
    grey: NDArray[np.uint8], narrowest: float, widest: float, scale: float
) -> list[tuple[int, float, float]]:
    found = []
    rows, width = grey.shape
    for v, line in enumerate(grey.astype(float)):
        h = max(1, int(scale * (FILTER[0] + FILTER[1] * v / (rows - 1)) + 0.5))
        means = np.convolve(line, np.ones(h) / h, "valid")
        before, after = means[: width - 2 * h + 1], means[h:]
        least = EDGE[0] * np.minimum(before, after) + EDGE[1]
        step = np.where(np.abs(after - before) > least + 1e-9, np.sign(after - before), 0)
        rising: float | None = None
        edges = [(s, 1) for s in runs_of(step > 0)] + [(s, -1) for s in runs_of(step < 0)]
        for (first, stop), sign in sorted(edges):
            middle = h + (first + stop - 1) / 2 - 0.5
            if sign > 0:
                rising = middle
            elif rising is not None:
                if narrowest <= middle - rising <= widest:
                    found.append((v, rising, middle))
                rising = None
    return found


def limits(rows: int) -> tuple[FloatArray, FloatArray]:
    return np.full(rows, LIMITS[0]), np.full(rows, LIMITS[1])


@pytest.mark.parametrize("seed", range(20))
def test_edge_pairs_equal_plain_numpy(seed: int) -> None:
    grey = blurred(seed)
    row, left, right = edge_pairs(grey, 0, *limits(len(grey)), 0.4)
    assert list(zip(row, left, right, strict=True)) == pairs_by_numpy(grey, *LIMITS, 0.4)


def seeds_by_python(
    row: FloatArray, left: FloatArray, right: FloatArray, near: float, turn: float, kept: float
) -> list[int]:
    seeds: list[dict[str, float]] = []
    number = []
    for v, a, b in zip(row, left, right, strict=True):
        u, best, least = (a + b) / 2, None, near
        for k, s in enumerate(seeds):
            down, across = v - s["v"], u - (s["a"] + s["b"]) / 2
            square = down**2 + across**2
            lean = np.arctan2(across, down)
            if down <= 0 or a > s["b"] or b < s["a"] or square >= least:
                continue
            if s["n"] >= 2 and abs(lean - s["lean"]) >= turn:
                continue
            best, least = k, square
        if best is None:
            seeds.append({"v": v, "a": a, "b": b, "n": 1, "lean": 0.0})
            number.append(len(seeds) - 1)
            continue
        s = seeds[best]
        lean = np.arctan2(u - (s["a"] + s["b"]) / 2, v - s["v"])
        s["lean"] = lean if s["n"] == 1 else kept * s["lean"] + (1 - kept) * lean
        s.update(v=v, a=a, b=b, n=s["n"] + 1)
        number.append(best)
    return number


@pytest.mark.parametrize("seed", range(20))
def test_seeds_equal_plain_python(seed: int) -> None:
    rng = np.random.default_rng(seed)
    row = np.sort(rng.integers(0, 40, 120))
    left = rng.integers(0, 60, 120) / 2
    right = left + rng.integers(4, 16, 120) / 2
    found = seeds_of(row, left, right, 90.0)
    assert found.tolist() == seeds_by_python(row, left, right, 90.0, 0.8, 0.8)
    assert found.max() < 110


def test_the_lines_of_a_road_are_seeds_and_a_blank_road_has_no_seeds() -> None:
    where = road_of(CAMERA, 40.0, 0.078, 0.3)
    markings = find_markings(road(THREE)[:, :, 0].copy(), where)
    _, y = image_to_road(CAMERA, markings.u, markings.row)
    for line in THREE:
        # The left one leaves the picture soon, the middle one is dashed.
        assert (np.abs(y - line.offset_m) < 0.1).sum() >= 8
    assert (np.abs(y[:, None] - [line.offset_m for line in THREE]).min(axis=1) < 0.1).mean() > 0.95
    assert (np.diff(markings.row)[np.diff(markings.seed) == 0] > 0).all()
    blank = find_markings(road(())[:, :, 0].copy(), where)
    assert len(blank.starts) == 1
    assert not len(blank)


def test_ignored_parts_have_no_markings() -> None:
    right_half = (240, 0, 480, 270)
    where = road_of(replace(CAMERA, ignore=(right_half,)), 40.0, 0.078, 0.3)
    markings = find_markings(road(THREE)[:, :, 0].copy(), where)
    assert len(markings)
    assert (markings.u < 240).all()
