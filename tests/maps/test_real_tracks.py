"""A recorded drive with GNSS: on which road it was."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("shapely")
pytest.importorskip("pyproj")

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.matching import match
from tests.kits.tracks import rotterdam_receivers, rotterdam_road


@pytest.fixture(scope="module")
def data() -> Path:
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "tracks"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("recorded drives: needs EGOLANE_DATA with a folder tracks")
    return folder.parent


@pytest.fixture(scope="module")
def road(data: Path) -> LaneGraph:
    return rotterdam_road(data)


def test_every_receiver_is_within_metres_of_its_road(data: Path, road: LaneGraph) -> None:
    for name, drove in rotterdam_receivers(data).items():
        found = match(road, drove)
        assert (found.segment >= 0).all(), name
        assert np.median(np.abs(found.offset_m)) < 3
        assert np.abs(found.offset_m).max() < 12


def test_gross_outliers_in_a_recorded_drive_are_rejected(data: Path, road: LaneGraph) -> None:
    drove = rotterdam_receivers(data)["GoPro"]
    rng = np.random.default_rng(0)
    wrong = np.sort(rng.choice(np.arange(10, len(drove) - 10), 40, replace=False))
    latitude = drove.latitude.copy()
    latitude[wrong] += rng.choice([-1, 1], 40) * rng.uniform(0.005, 0.05, 40)
    spoilt = replace(drove, latitude=latitude)
    found = match(road, spoilt)
    assert found.is_outlier[wrong].all()
    assert found.is_outlier.sum() == len(wrong)
    # The place on the road is bridged.
    table, whole = (locate(road, p) for p in (spoilt, drove))
    at = np.searchsorted(table.t_s, drove.t_s[wrong])
    as_it_was = np.searchsorted(whole.t_s, drove.t_s[wrong])
    assert (table.segment[at] == whole.segment[as_it_was]).all()
    assert np.median(np.abs(table.along_m[at] - whole.along_m[as_it_was])) < 2
