"""`python -m makers.maps`: how often the right segment is found, on trips over the two real maps.

Needs EGOLANE_DATA with a folder maps.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.types import IntArray
from tests.kits.lane_maps import random_trip
from tests.reference.nearest_road import lock_on_road

MAPS = ("north-bayreuth_A9_A70", "bautzen_A4")

#: Least number of positions on each map.
N_POSITIONS = 4000

#: A wrong second is near a join of both segments if it is at most so far from it, metres; and the
#: answer is unsure if it has at most this probability.
NEAR_M, UNSURE = 10.0, 0.6


def measure() -> Iterator[str]:
    """Lines of a table."""
    yield (
        "| map | positions | offline | online | nearest road | wrong offline | no join near"
        " | and sure |"
    )
    yield "|---|---:|---:|---:|---:|---:|---:|---:|"
    if not os.environ.get("EGOLANE_DATA"):
        raise SystemExit("needs EGOLANE_DATA with a folder maps")
    for name in MAPS:
        graph = read_osm(Path(os.environ["EGOLANE_DATA"]) / "maps" / f"{name}.osm")
        rng = np.random.default_rng(0)
        right: dict[str, list[int]] = {"offline": [], "online": [], "nearest": []}
        frames: list[int] = []
        kinds = np.zeros(3, dtype=int)
        while sum(frames) < N_POSITIONS:
            positions, segment = random_trip(graph, rng)
            offline = locate(graph, positions)
            online = locate(graph, positions, online=True).segment
            nearest = lock_on_road(graph, positions).segment
            for key, found in zip(right, (offline.segment, online, nearest), strict=True):
                right[key].append(int((found == segment).sum()))
            frames.append(len(segment))
            kinds += _wrong(graph, offline, segment)
        cells = " | ".join(text(share(hits, frames)) for hits in right.values())
        yield f"| {name} | {sum(frames)} | {cells} | {' | '.join(map(str, kinds))} |"


def _wrong(graph: LaneGraph, found: pd.DataFrame, segment: IntArray) -> tuple[int, int, int]:
    """How many rows are wrong; how many of them have no join to the right segment near the place
    that was found; and how many of those are sure."""
    joins = set(zip(graph.before.tolist(), graph.after.tolist(), strict=True))
    wrong = np.flatnonzero(found.segment != segment)
    far = []
    for k in wrong:
        here, there, along = int(found.segment[k]), int(segment[k]), float(found.along_m[k])
        ahead = (here, there) in joins and graph.length_m[here] - along < NEAR_M
        if not ahead and not ((there, here) in joins and along < NEAR_M):
            far.append(float(found.sure[k]))
    return len(wrong), len(far), sum(sure > UNSURE for sure in far)


def share(right: Sequence[int], frames: Sequence[int]) -> tuple[float, float, float]:
    """A share of frames, and its 95 % interval by resampling the drives 2,000 times."""
    a, b = np.array(right, dtype=float), np.array(frames, dtype=float)
    rows = np.random.default_rng(0).integers(0, len(a), (2000, len(a)))
    low, high = np.quantile(a[rows].sum(axis=1) / b[rows].sum(axis=1), [0.025, 0.975])
    return a.sum() / b.sum(), float(low), float(high)


def text(found: tuple[float, float, float]) -> str:
    return ("{:.3f} ({:.3f} to {:.3f})".format(*found)).replace("0.", ".").replace("1.000", "1")


if __name__ == "__main__":
    for line in measure():
        print(line, flush=True)
