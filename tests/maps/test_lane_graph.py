"""The lane graph and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from egolane_pgm.maps.lane_graph import LaneGraph, joins_from, load, save
from egolane_pgm.types import InputError


def small_graph() -> LaneGraph:
    """A road of three lanes, an exit at the right, the road with two lanes."""
    return LaneGraph(
        way=np.array([7, 8, 9]),
        kind=np.array(["motorway", "motorway", "motorway_link"]),
        name=np.array(["A 9", "A 9", ""], dtype=object),
        n_lanes=np.array([3, 2, 0]),
        point=np.array(
            [[50.0, 11.0], [50.1, 11.0], [50.1, 11.0], [50.2, 11.0]] + [[50.1, 11.1]] * 2
        ),
        first=np.array([0, 2, 4, 6]),
        length_m=np.array([11_000.0, 11_000.0, 0.0]),
        before=np.array([0, 0]),
        after=np.array([1, 2]),
    )


def test_a_graph_is_stored_and_comes_back_as_it_was(tmp_path: Path) -> None:
    graph = small_graph()
    save(graph, tmp_path / "lanes.parquet")
    again = load(tmp_path / "lanes.parquet")
    for name in LaneGraph.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name), err_msg=name)
        assert getattr(again, name).dtype.kind == getattr(graph, name).dtype.kind
    assert repr(again) == "LaneGraph(3 segments, 22.0 km, 2 joins)"


def test_joins_are_found_by_the_segment_that_they_leave() -> None:
    graph = small_graph()
    np.testing.assert_array_equal(joins_from(graph), [0, 2, 2, 2])
    np.testing.assert_array_equal(graph.line(1), graph.point[2:4])


def test_a_file_that_is_no_lane_graph_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    with pytest.raises(InputError, match=r"x\.parquet: cannot be read: No such"):
        load(path)
    path.write_bytes(b"PAR1 not")
    with pytest.raises(InputError, match=r"x\.parquet: is not a whole Parquet file"):
        load(path)
    parquet.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(InputError, match=r"x\.parquet: no lane graph"):
        load(path)
    save(small_graph(), path)
    table = parquet.read_table(path)
    parquet.write_table(table.replace_schema_metadata({"egolane_lane_graph": "9"}), path)
    with pytest.raises(InputError, match="version 9, not 1"):
        load(path)
    with pytest.raises(InputError, match=r"lanes\.csv: a lane graph is a \.parquet file"):
        save(small_graph(), tmp_path / "lanes.csv")
