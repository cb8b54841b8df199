"""Two recorded drives with GNSS: on which road, and what the offset alone says of the lane."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps.index import RoadIndex
from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.matching import match
from tests.kits.tracks import (
    munich,
    munich_more,
    rotterdam_lanes,
    rotterdam_receivers,
    rotterdam_road,
)


@pytest.fixture(scope="module")
def data() -> Path:
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "tracks"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("recorded drives: needs EGOLANE_DATA with a folder tracks")
    return folder.parent


@pytest.fixture(scope="module")
def road(data: Path) -> tuple[LaneGraph, RoadIndex]:
    return rotterdam_road(data)


def test_every_receiver_is_within_metres_of_its_road(
    data: Path, road: tuple[LaneGraph, RoadIndex]
) -> None:
    for name, drove in rotterdam_receivers(data).items():
        found = match(*road, drove)
        assert (found.segment >= 0).all(), name
        assert np.median(np.abs(found.offset_m)) < 3
        assert np.abs(found.offset_m).max() < 12


def test_gross_outliers_in_a_recorded_drive_are_rejected(
    data: Path, road: tuple[LaneGraph, RoadIndex]
) -> None:
    drove = rotterdam_receivers(data)["GoPro"]
    rng = np.random.default_rng(0)
    wrong = np.sort(rng.choice(np.arange(10, len(drove) - 10), 40, replace=False))
    latitude = drove.latitude.copy()
    latitude[wrong] += rng.choice([-1, 1], 40) * rng.uniform(0.005, 0.05, 40)
    spoilt = replace(drove, latitude=latitude)
    found = match(*road, spoilt)
    assert found.is_outlier[wrong].all()
    assert found.is_outlier.sum() == len(wrong)
    # The place on the road is bridged.
    table, whole = (locate(*road, p) for p in (spoilt, drove))
    at = np.searchsorted(table.t_s, drove.t_s[wrong])
    as_it_was = np.searchsorted(whole.t_s, drove.t_s[wrong])
    assert (table.segment[at] == whole.segment[as_it_was]).all()
    assert np.median(np.abs(table.along_m[at] - whole.along_m[as_it_was])) < 2


def test_the_lane_after_a_change_is_told_better_than_by_the_usual_lane(
    data: Path, road: tuple[LaneGraph, RoadIndex]
) -> None:
    found = [rotterdam_lanes(data, *road, drove) for drove in rotterdam_receivers(data).values()]
    right = np.mean([f.right.mean() for f in found])
    usual = np.mean([(f.lane == np.bincount(f.lane).argmax()).mean() for f in found])
    assert len(found[0].lane) == 55
    assert usual == pytest.approx(24 / 55)
    assert right > usual + 0.15


def test_a_road_with_more_lanes_than_the_map_says_is_noticed(data: Path) -> None:
    drive = munich(data)
    wrong = (drive.road == "A 92") & (drive.lane > drive.n_lanes)
    assert wrong.sum() == 14
    stretch = drive[drive.run == drive.run[wrong].iloc[0]]
    is_wrong = (stretch.lane > stretch.n_lanes).to_numpy()
    assert munich_more(stretch, smooth=True)[is_wrong].min() > 0.9
    # Knowing the past only, it is noticed when the car has used the width of three lanes.
    causal = munich_more(stretch, smooth=False)
    assert causal[0] < 0.15
    assert causal[np.flatnonzero(is_wrong)[-1]] > 0.6
    # Four lanes on the map, and four there.
    right = drive[(drive.road == "A 9") & (drive.n_lanes == 4)]
    assert munich_more(right, smooth=False).mean() < 0.2
