"""Simulated drives over maps, and the belief about their lane."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from egolane_pgm.maps.interchange import mirrored
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.osm import read_osm

MAPS = ("north-bayreuth_A9_A70", "bautzen_A4")


@cache
def data() -> Path:
    if not os.environ.get("EGOLANE_DATA"):
        raise SystemExit("needs EGOLANE_DATA with the folders maps and tracks")
    return Path(os.environ["EGOLANE_DATA"])


@cache
def real_maps() -> dict[str, LaneGraph]:
    """The two real maps (© OpenStreetMap contributors, ODbL) and their mirror images."""
    graphs = {name: read_osm(data() / "maps" / f"{name}.osm") for name in MAPS}
    return graphs | {f"{name}, mirrored": mirrored(graph) for name, graph in graphs.items()}


def share(right: Sequence[int], frames: Sequence[int]) -> tuple[float, float, float]:
    """A share of frames, and its 95 % interval by resampling the drives 2,000 times."""
    a, b = np.array(right, dtype=float), np.array(frames, dtype=float)
    rows = np.random.default_rng(0).integers(0, len(a), (2000, len(a)))
    low, high = np.quantile(a[rows].sum(axis=1) / b[rows].sum(axis=1), [0.025, 0.975])
    return a.sum() / b.sum(), float(low), float(high)


def text(found: tuple[float, float, float]) -> str:
    return ("{:.3f} ({:.3f} to {:.3f})".format(*found)).replace("0.", ".").replace("1.000", "1")
