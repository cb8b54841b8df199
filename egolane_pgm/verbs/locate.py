"""The verb `locate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from egolane_pgm.maps import road_table
from egolane_pgm.maps.locating import locate as locate_on
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.options import ColumnNames, Option, StrPath, Target
from egolane_pgm.types import InputError

#: Later times are seconds since 1970.
_DATES = 1e8

EXAMPLES = ("egolane locate roads.osm.pbf drive.gpx -o road.parquet",)


def locate(
    map: StrPath,
    positions: StrPath,
    *,
    out: Target = None,
    online: bool = False,
    columns: ColumnNames = None,
    shift: Annotated[float, Option("SECONDS")] = 0.0,
) -> pd.DataFrame:
    """Find the road of a car: segment, place on it, number of lanes, and probability.

    MAP is an extract of OpenStreetMap (.osm, .osm.pbf). POSITIONS is a .csv, .parquet, .gpx or bag
    of a GNSS receiver. Experiments with `n_lanes: map` read the road table. Take the roads out of a
    large extract first:
    osmium tags-filter FILE w/highway=motorway,motorway_link,trunk,trunk_link -o ROADS.osm.pbf

    - out: the road table, .parquet.
    - online: use earlier positions only.
    - columns: names of a table's columns, e.g. t_s=when,latitude=lat_gps; topic=/fix of a bag.
    - shift: added to the positions' times, to have the clock of the recording of lines.

    Returns the road table. Raises InputError for arguments that do not fit.
    """
    file = None if out is None else Path(out)
    if file is not None:
        if file.suffix.lower() != ".parquet":
            raise InputError(f"{file}: a road table is a .parquet file")
        check_place(file)
    graph = read_osm(Path(map))
    named = {ours: str(theirs) for ours, theirs in column_keys(columns or {}).items()}
    read = read_positions(Path(positions), columns=named)
    table = locate_on(graph, replace(read, t_s=read.t_s + shift), online=online)
    if file is not None:
        road_table.save(table, file)
    return table


def summary(done: pd.DataFrame, given: Mapping[str, Any]) -> str:
    """Summarise the table and the fit of the map."""
    on = done.segment >= 0
    off_by = np.abs(done.offset_m[np.isfinite(done.offset_m)])
    n_lanes = np.unique(done.n_lanes[on & (done.n_lanes > 0)])
    assumed = (on & (done.unknown_way != 0)).mean()
    ends, unit = done.t_s.iloc[[0, -1]], "s"
    first, last = (f"{t:g}" for t in ends)
    if ends.iloc[0] > _DATES:
        first, last = pd.to_datetime(ends, unit="s").dt.strftime("%Y-%m-%d %H:%M:%S")
        unit = "UTC"
    return (
        f"{given['out']}: {len(done)} rows, {first} to {last} {unit},"
        f" {on.mean():.1%} on the map\n"
        f"half of the positions lie within {np.median(off_by):.1f} m of the way's line;"
        f" lanes: {', '.join(str(n) for n in n_lanes) or 'unknown'}"
        f"{f' (assumed in {assumed:.1%} of the rows)' if assumed else ''};"
        f" mean probability of the segment {done.sure[on].mean():.3f}"
    )
