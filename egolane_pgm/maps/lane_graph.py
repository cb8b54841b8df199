"""A road map as a graph: segments with a number of lanes, and joins between them.

The graph is stored as one Parquet table, so that
a map is read from OpenStreetMap once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.maps.stored import check_path, marks, read_stored
from egolane_pgm.tools.files import write_parquet
from egolane_pgm.types import FloatArray, IntArray

#: The version of the stored table. It changes where a column gets another meaning.
VERSION = "1"


@dataclass(frozen=True)
class LaneGraph:
    """S segments and J joins.

    A segment is a directed carriageway with constant tags: ways of the map are joined across splits
    that change nothing. A road for both directions is two segments.

    - way (S,): OpenStreetMap's id of the first way.
    - kind (S,): its tag `highway`, such as "motorway" or "motorway_link".
    - name (S,): the road's number (tag `ref`) or name; "" where it has none. Python strings.
    - n_lanes (S,): 0 where unknown.
    - point (P, 2): latitude and longitude, degrees, in the direction of travel.
    - first (S + 1,): where each segment's points begin; those of segment k are
      `point[first[k]:first[k + 1]]`, at least two.
    - length_m (S,): along the points.
    - before, after (J,): the segments that a join leads from and to, sorted by before, then after.
    """

    way: IntArray
    kind: NDArray[np.str_]
    name: NDArray[np.object_]
    n_lanes: IntArray
    point: FloatArray
    first: IntArray
    length_m: FloatArray
    before: IntArray
    after: IntArray

    def __len__(self) -> int:
        return len(self.way)

    def __repr__(self) -> str:
        return (
            f"LaneGraph({len(self)} segments, {self.length_m.sum() / 1000:.1f} km,"
            f" {len(self.before)} joins)"
        )

    def line(self, segment: int) -> FloatArray:
        """The points (K, 2) of a segment: latitude and longitude, degrees."""
        return self.point[self.first[segment] : self.first[segment + 1]]


def joins_from(graph: LaneGraph) -> IntArray:
    """Where the joins that leave each segment begin, (S + 1,): those of segment k are the rows
    `start[k]:start[k + 1]` of `before` and `after`."""
    return np.searchsorted(graph.before, np.arange(len(graph) + 1)).astype(np.int64)


def with_guesses(graph: LaneGraph) -> LaneGraph:
    """The graph with a number of lanes on segments that tell none: that of the road of its kind
    before it, the widest of several, else of the one behind it, else what most metres of its kind
    have. 0 stays where no segment of its kind tells any."""
    n_lanes = graph.n_lanes
    if (n_lanes > 0).all():
        return graph
    along = graph.kind[graph.before] == graph.kind[graph.after]
    before, after = graph.before[along], graph.after[along]
    guess = n_lanes.copy()
    for here, there in ((before, after), (after, before)):
        is_new = True
        # A number goes on by one segment each time, through all that tell none.
        while is_new:
            found = np.zeros(len(graph), dtype=np.int64)
            np.maximum.at(found, there, guess[here])
            new = (guess == 0) & (found > 0)
            guess[new] = found[new]
            is_new = bool(new.any())
    for kind in np.unique(graph.kind[guess == 0]):
        told = (graph.kind == kind) & (n_lanes > 0)
        if told.any():
            usual = np.bincount(n_lanes[told], weights=graph.length_m[told]).argmax()
            guess[(graph.kind == kind) & (guess == 0)] = usual
    return replace(graph, n_lanes=guess)


def ways_named(ways: IntArray) -> str:
    """The first three of some ways (K,), each once, for a message: `ways 5, 7, 9 and 4 more`."""
    known = list(dict.fromkeys(ways.tolist()))
    more = f" and {len(known) - 3} more" if len(known) > 3 else ""
    return f"way{'s' * (len(known) > 1)} {', '.join(map(str, known[:3]))}{more}"


# --- a file ------------------------------------------------------------------------------------

_OF_SEGMENT = (
    ("way", "int64"),
    ("kind", "string"),
    ("name", "string"),
    ("n_lanes", "int64"),
    ("length_m", "float64"),
)
_OF_POINT = (("latitude", "float64"), ("longitude", "float64"))
_OF_JOIN = (("after", "int64"),)


def _schema() -> Any:
    # pyarrow is imported only for a file.
    import pyarrow as pa

    kinds = {name: pa.type_for_alias(kind) for name, kind in (*_OF_SEGMENT, *_OF_POINT, *_OF_JOIN)}
    columns = [(name, kinds[name]) for name, _ in _OF_SEGMENT]
    columns += [(name, pa.list_(kinds[name])) for name, _ in (*_OF_POINT, *_OF_JOIN)]
    return pa.schema(columns, metadata=marks("lane graph", VERSION))


def save(graph: LaneGraph, path: str | Path) -> None:
    """Write a graph as one Parquet table with a row per segment, which holds lists of its points
    (`latitude`, `longitude`) and of the joins that leave it (`after`: the row of the next segment,
    from 0).

    Raises InputError for a name that does not end in .parquet, and where it cannot be written.
    """
    import pyarrow as pa

    check_path(path, "lane graph")
    given = {name: getattr(graph, name, None) for name, _ in (*_OF_SEGMENT, *_OF_JOIN)}
    given["latitude"], given["longitude"] = graph.point.T
    start = joins_from(graph)

    def column(name: str, kind: Any) -> Any:
        return pa.array(given[name], pa.type_for_alias(kind))

    def lists(name: str, kind: Any, first: IntArray) -> Any:
        return pa.ListArray.from_arrays(pa.array(first, pa.int32()), column(name, kind))

    columns = [
        *(column(name, kind) for name, kind in _OF_SEGMENT),
        *(lists(name, kind, graph.first) for name, kind in _OF_POINT),
        *(lists(name, kind, start) for name, kind in _OF_JOIN),
    ]
    write_parquet(Path(path), pa.table(columns, schema=_schema()))


def load(path: str | Path) -> LaneGraph:
    """The graph that `save` wrote, as it was. Raises InputError as `read_stored`."""
    import pyarrow as pa

    table = read_stored(path, "lane graph", VERSION)
    whole = {name: table[name].combine_chunks() for name in table.column_names}

    def values(name: str) -> Any:
        array = whole[name].flatten() if pa.types.is_list(whole[name].type) else whole[name]
        return array.to_numpy(zero_copy_only=False)

    def words(name: str) -> Any:
        # Equal words are one object, so that a million names are not a million strings.
        array = whole[name].dictionary_encode()
        known = np.array(array.dictionary.to_pylist(), dtype=object)
        return known[array.indices.to_numpy(zero_copy_only=False)]

    def codes(name: str) -> Any:
        found = values(name)
        return found.astype(np.str_) if len(found) else np.zeros(0, dtype="<U1")

    def starts(name: str) -> IntArray:
        size = whole[name].value_lengths().to_numpy(zero_copy_only=False)
        return np.concatenate([[0], np.cumsum(size)]).astype(np.int64)

    return LaneGraph(
        way=values("way"),
        kind=codes("kind"),
        name=words("name"),
        n_lanes=values("n_lanes"),
        point=np.stack([values("latitude"), values("longitude")], axis=1),
        first=starts("latitude"),
        length_m=values("length_m"),
        before=np.repeat(np.arange(table.num_rows, dtype=np.int64), np.diff(starts("after"))),
        after=values("after"),
    )


# --- geometry ----------------------------------------------------------------------------------


def metres_per_degree(latitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Metres to the north and to the east of one degree, on the ellipsoid WGS 84, at latitudes in
    degrees; good to a millionth over the length of a street."""
    radius_m, flattening = 6_378_137.0, 1 / 298.257223563
    squared = flattening * (2 - flattening)
    phi = np.radians(latitude)
    w = np.sqrt(1 - squared * np.sin(phi) ** 2)
    degree = np.pi / 180
    return degree * radius_m * (1 - squared) / w**3, degree * radius_m * np.cos(phi) / w


def along_points(point: FloatArray, first: IntArray) -> FloatArray:
    """Metres from the start of its segment to each point, (P,).

    - point (P, 2), first (S + 1,): as in LaneGraph.
    """
    step = np.diff(point, axis=0, prepend=point[:1])
    north, east = metres_per_degree(point[:, 0] - step[:, 0] / 2)
    metres = np.hypot(step[:, 0] * north, step[:, 1] * east)
    metres[first[:-1]] = 0.0
    total = np.cumsum(metres)
    along: FloatArray = total - np.repeat(total[first[:-1]], np.diff(first))
    return along
