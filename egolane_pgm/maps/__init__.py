"""Maps: the lanes of the road, where they lead, and where the car is on them.

The lanes are those of OpenStreetMap (© OpenStreetMap contributors, ODbL). They are read by
libraries of the package's extra `maps`, which are imported where they are used.
"""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.maps.lane_graph import LaneGraph, load
from egolane_pgm.maps.osm import read_osm


def load_map(path: str | Path) -> LaneGraph:
    """The lanes of a map: of an extract of OpenStreetMap (`.osm`, `.osm.pbf`, needs the extra
    `maps`), or of a `.parquet` file that `lane_graph.save` wrote.

    Warns and raises InputError as `read_osm` and `load` do.
    """
    if Path(path).suffix.lower() != ".parquet":
        return read_osm(path)
    return load(path)
