"""Maps: the lanes of the road, where they lead, and where the car is on them.

The lanes are those of OpenStreetMap (© OpenStreetMap contributors, ODbL). They are read by
libraries of the package's extra `maps`, which are imported where they are used.
"""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.maps.lane_graph import LaneGraph, load
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.types import InputError


def load_map(path: str | Path, *, drives_left: bool | None = None) -> LaneGraph:
    """The lanes of a map: of an extract of OpenStreetMap (`.osm`, `.osm.pbf`, needs the extra
    `maps`), or of a `.parquet` file that `egolane map` wrote.

    - drives_left: as in `read_osm`; of an extract only, a lane graph has it in its shifts.

    Warns and raises InputError as `read_osm` and `load` do, and for a side with a lane graph.
    """
    if Path(path).suffix.lower() != ".parquet":
        return read_osm(path, drives_left=drives_left)
    if drives_left is not None:
        raise InputError(f"{path}: a lane graph knows the side of traffic since it was made")
    return load(path)
