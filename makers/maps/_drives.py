"""Simulated drives over maps, and the belief about their lane."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

import egolane_pgm as ego
from egolane_pgm.experiment import Gnss, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.maps.interchange import InterchangeDrive, mirrored
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.lanes_from_gnss import across
from egolane_pgm.maps.on_map import with_positions
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.maps.steps import LanesAlong, lanes_along, road_changes
from egolane_pgm.model import make_evidence, prepare_model
from egolane_pgm.types import BoolArray, FloatArray
from tests.kits.lane_maps import without_lines

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


def lane_belief(
    drive: InterchangeDrive, road: RoadTable, hidden: BoolArray, noise: Sequence[Gnss | None]
) -> tuple[list[FloatArray], LanesAlong]:
    """The belief over lanes (T, n) of a drive, once for each of `noise`, the positions' (None:
    without them); and the lanes of the road.

    - road: the road table that the lanes are taken from. hidden (T,): frames without lines.
    """
    found = road_changes(road)
    most = int(max([found.n_lanes.max(), drive.truth.lane.max(), *(s.after for s in found.steps)]))
    place = ego.experiments_folder() / "maps" / "interchange.yaml"
    road_is = {"n_lanes": most, "parameters": {"steps": found.vocabulary()}}
    model = prepare_model(load_experiment(place, road_is))
    time_s = drive.log.time_s
    lanes = lanes_along(
        road, time_s, steps=found.vocabulary(), n_lanes=most,
        place_sigma_m=float(model.parameters["place_sigma_m"]),
    )  # fmt: skip
    log = without_lines(drive.log, hidden)
    lines = make_evidence(model, log, "soft", lanes).filtered
    beliefs = []
    for gnss in noise:
        given = lines
        if gnss is not None:
            seen = across(road, time_s, lanes.n_lanes, gnss.lane_width_m)
            given = with_positions(model.compiled, log, lines, seen, gnss)
        beliefs.append(filter_beliefs(model.compiled, given, "exact").lane)
    return beliefs, lanes


def share(right: Sequence[int], frames: Sequence[int]) -> tuple[float, float, float]:
    """A share of frames, and its 95 % interval by resampling the drives 2,000 times."""
    a, b = np.array(right, dtype=float), np.array(frames, dtype=float)
    rows = np.random.default_rng(0).integers(0, len(a), (2000, len(a)))
    low, high = np.quantile(a[rows].sum(axis=1) / b[rows].sum(axis=1), [0.025, 0.975])
    return a.sum() / b.sum(), float(low), float(high)


def text(found: tuple[float, float, float]) -> str:
    return ("{:.3f} ({:.3f} to {:.3f})".format(*found)).replace("0.", ".").replace("1.000", "1")
