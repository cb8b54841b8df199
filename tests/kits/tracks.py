"""The two recorded drives with GNSS and annotated lane changes, and what is asked of them.

Rotterdam: github tomdries/gps-lane-changes (BSD-2). Munich: github lilManta/Lane_Level_Matching
(LGPL-2.1), lanes counted from the right there.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.maps.index import RoadIndex, index_of
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.local import around
from egolane_pgm.maps.matching import match
from egolane_pgm.maps.positions import Positions, read_positions
from egolane_pgm.types import FloatArray
from tests.kits.gnss_alone import AloneNoise, lanes_from_offsets
from tests.kits.lane_maps import lane_map

ROTTERDAM = "tracks/gps_lane_changes"
MUNICH = "tracks/munich"


def rotterdam_road(data: Path) -> tuple[LaneGraph, RoadIndex]:
    """The route as a map: a segment for each stretch without a gap, lanes unknown."""
    route = pd.read_csv(data / ROTTERDAM / "route 1 mindist10.csv")
    metres = around(route.lat.to_numpy(), route.lon.to_numpy()).metres(route.lat, route.lon)
    cuts = [0, *np.flatnonzero(route.distance > 150), len(route)]
    parts = [slice(a, b) for a, b in itertools.pairwise(cuts) if b - a > 1]
    drawn = lane_map([[tuple(p) for p in metres[part]] for part in parts], [0] * len(parts), [])
    places = np.concatenate([route[["lat", "lon"]].to_numpy()[part] for part in parts])
    graph = LaneGraph(**(vars(drawn) | {"point": places}))
    return graph, index_of(graph)


def rotterdam_receivers(data: Path) -> dict[str, Positions]:
    names = {"t_s": "t", "latitude": "lat_gps", "longitude": "lon_gps"}
    files = sorted((data / ROTTERDAM).glob("01*.csv"))
    return {f.stem.split()[2]: read_positions(f, columns=names) for f in files}


@dataclass(frozen=True)
class ChangeAnswers:
    """Per annotated change with a known number of lanes, (C,): whether the most probable lane after
    it is the annotated one, its probability, whether the lane nearest to the last offset is, and
    the annotated lane."""

    right: np.ndarray
    probability: FloatArray
    nearest: np.ndarray
    lane: np.ndarray


def rotterdam_lanes(
    data: Path,
    graph: LaneGraph,
    index: RoadIndex,
    drove: Positions,
    noise: AloneNoise | None = None,
    *,
    seconds: int = 20,
    every: int = 1,
) -> ChangeAnswers:
    """Which lane a car is in 5 s after each change (or half way to the next), from its offsets
    alone, those of `seconds` before, one in `every` seconds. The map has no lanes: their number is
    the annotated one."""
    changes = pd.read_csv(data / ROTTERDAM / "lane change annotations with sections trip 1.csv")
    offset = match(graph, index, drove).offset_m
    noise = noise or AloneNoise(count_wrong=0.0, count_stays=1.0)
    thinned = noise.model_copy(
        update={"drift_s": noise.drift_s / every, "change": noise.change * every}
    )
    found = []
    after = np.append(changes.t_lc.to_numpy()[1:], np.inf)
    for row, later in zip(changes.itertuples(), after, strict=True):
        lane, n = int(row[6]), row[7]
        if np.isnan(n):
            continue
        at = row.t_lc + min(5.0, (later - row.t_lc) / 2)
        seen = offset_each_second(drove.t_s, offset, at - seconds, at)
        belief = lanes_from_offsets(seen[::-1][::every][::-1], int(n), thinned).lane[-1]
        known = seen[~np.isnan(seen)]
        nearest = np.clip(np.rint(known[-1] / 3.5 + (n + 1) / 2), 1, n) if len(known) else 0
        found.append((belief.argmax() + 1 == lane, belief[lane - 1], nearest == lane, lane))
    right, probability, nearest, lane = map(np.array, zip(*found, strict=True))
    return ChangeAnswers(right, probability, nearest, lane)


def offset_each_second(
    t_s: FloatArray, offset: FloatArray, start: float, stop: float
) -> FloatArray:
    """The offsets on a grid of seconds; NaN where no position is near."""
    grid = np.arange(start, stop + 0.01)
    row = np.searchsorted(t_s, grid + 0.5, side="right") - 1
    near = (row >= 0) & (np.abs(t_s[row] - grid) <= 0.75)
    return np.where(near, offset[np.maximum(row, 0)], np.nan)


#: In the drive of Munich the matched line is the middle between the carriageways. The left edge of
#: the lanes is this far from it, metres, on a German motorway (half of the median of 4 m and the
#: marginal strip of 0.75 m), and lanes are so wide.
MUNICH_EDGE_M, MUNICH_LANE_M = 2.75, 3.75


def munich(data: Path) -> pd.DataFrame:
    """Second by second: road, n_lanes (the map's), lane (from the right, annotated), offset_m to
    the right of the matched line, and run, which counts stretches of one road and one n."""
    folder = data / MUNICH
    path = pd.read_csv(folder / "data/Dataframes/MapMatching/pathTaken.csv")
    fixes = pd.read_csv(folder / "data/measurements/Gps_datetime.csv").iloc[path.GPSindex]
    truth = pd.read_csv(folder / "ground_truth_lane_changes.csv")
    time = pd.to_datetime(fixes.time).to_numpy()
    changed = pd.to_datetime("2020-04-24 " + truth.time).to_numpy()
    row = np.searchsorted(changed, time, side="right") - 1
    plane = around(fixes.latitude.to_numpy(), fixes.longitude.to_numpy())
    place = plane.metres(fixes.latitude, fixes.longitude)
    line = plane.metres(path.latitude, path.longitude)
    heading = np.gradient(place, axis=0)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True) + 1e-9
    off = place - line
    n = path.numberOfLanes
    is_new = (path.roadName != path.roadName.shift()) | (n != n.shift())
    return pd.DataFrame(
        {
            "road": path.roadName,
            "n_lanes": n,
            "lane": np.where(row >= 0, truth.lane_number.to_numpy()[np.maximum(row, 0)], 0),
            "offset_m": heading[:, 1] * off[:, 0] - heading[:, 0] * off[:, 1],
            "run": is_new.cumsum(),
        }
    )


def munich_more(stretch: pd.DataFrame, *, smooth: bool) -> FloatArray:
    """P(the road has more lanes than the map says) in each second of a stretch of one n."""
    n = int(stretch.n_lanes.iloc[0])
    centre = MUNICH_EDGE_M + n * MUNICH_LANE_M / 2
    offset = stretch.offset_m.to_numpy() - centre
    noise = AloneNoise(lane_width_m=MUNICH_LANE_M)
    return lanes_from_offsets(offset, n, noise, smooth=smooth).more
