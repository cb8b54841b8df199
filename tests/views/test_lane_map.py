"""The picture of a map shows its lanes where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from egolane_pgm.maps.lane_graph import LaneGraph
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.types import InputError
from egolane_pgm.views import lane_map
from egolane_pgm.views.lane_map import ATTRIBUTION, LANE_M, lane_map_figure
from egolane_pgm.views.style import write_figure
from tests.kits.osm_files import LATITUDE, LONGITUDE, write_osm


@pytest.fixture
def graph(tmp_path: Path) -> LaneGraph:
    """Three lanes to the east of which the right one leaves, as an exit, at the origin."""
    nodes = {1: (-300.0, 0.0), 2: (0.0, 0.0), 3: (400.0, 0.0), 4: (400.0, -90.0)}
    ways = [
        (10, [1, 2], {"highway": "motorway", "lanes": 3, "placement": "right_of:1"}),
        (11, [2, 3], {"highway": "motorway", "lanes": 2, "ref": "A 1"}),
        (12, [2, 4], {"highway": "motorway_link", "lanes": 1}),
    ]
    return read_osm(write_osm(tmp_path / "a.osm", nodes, ways))


def test_lanes_are_drawn_to_width_and_continue_one_another(graph: LaneGraph) -> None:
    ax = lane_map_figure(graph, (LATITUDE, LONGITUDE, 100.0)).axes[0]
    lanes = next(c for c in ax.collections if isinstance(c, PolyCollection))
    boxes = [path.get_extents() for path in lanes.get_paths()]
    # The link lies below the roads; these are lanes 1 to 3 before and 1 to 2 behind the exit.
    assert [len(boxes), len({tuple(c) for c in lanes.get_facecolors()})] == [6, 3]
    for k, box in enumerate(boxes[1:4]):
        assert (box.y1, box.y0) == pytest.approx(((1 - k) * LANE_M, -k * LANE_M), abs=0.1)
    for before, after in zip(boxes[1:3], boxes[4:6], strict=True):
        assert (before.y0, before.y1) == pytest.approx((after.y0, after.y1), abs=0.1)
    # The link's lane begins as the road's third, though its line begins at the road's.
    outline = lanes.get_paths()[0].vertices
    left, right = outline[0], outline[-2]
    np.testing.assert_allclose((left + right) / 2, [0, -1.5 * LANE_M], atol=1.3)
    assert np.hypot(*(left - right)) == pytest.approx(LANE_M)
    said = [text.get_text() for text in ax.texts]
    assert "3→2, s = 0" in said
    assert "3→1, s = -2" in said
    assert {"1", "2", "3"} <= set(said)


def test_lanes_are_as_wide_as_the_map_says(tmp_path: Path) -> None:
    """The way's line lies right of lane 1; a width that is none is the usual one."""
    nodes = {1: (-300.0, 0.0), 2: (300.0, 0.0)}
    tags = {"lanes": 4, "placement": "right_of:1", "width:lanes": "2.8|5|x|0.1"}
    ways = [(10, [1, 2], {"highway": "motorway", **tags})]
    graph = read_osm(write_osm(tmp_path / "a.osm", nodes, ways))
    ax = lane_map_figure(graph, (LATITUDE, LONGITUDE, 100.0)).axes[0]
    lanes = next(c for c in ax.collections if isinstance(c, PolyCollection))
    boxes = [path.get_extents() for path in lanes.get_paths()]
    edges = [2.8, 0.0, -5.0, -5.0 - LANE_M, -5.0 - 2 * LANE_M]
    for box, left, right in zip(boxes, edges[:-1], edges[1:], strict=True):
        assert (box.y1, box.y0) == pytest.approx((left, right), abs=0.1)


def test_a_whole_map_has_its_roads_drawn_out_and_names_who_made_it(graph: LaneGraph) -> None:
    figure = lane_map_figure(graph)
    assert len(figure.axes) == 2
    said = [text.get_text() for text in figure.axes[1].texts]
    assert {"3", "2"} <= set(said)
    assert any(text.startswith("motorway to the east") for text in said)
    assert figure.axes[1].get_xlim()[1] == pytest.approx(0.7, abs=0.01)
    assert ATTRIBUTION in [text.get_text() for text in figure.texts]


def test_a_map_that_is_too_large_to_see_is_refused(
    graph: LaneGraph, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(lane_map, "MOST_SEGMENTS", 2)
    with pytest.raises(InputError, match="3 segments are too many for a picture; name a place"):
        write_figure(lambda: lane_map_figure(graph), tmp_path / "map.png")
    with pytest.raises(InputError, match="no road lies there"):
        lane_map_figure(graph, (0.0, 0.0, 100.0))
