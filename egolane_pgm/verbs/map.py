"""The verb `map`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from egolane_pgm.maps import load_map
from egolane_pgm.maps.lane_graph import LaneGraph, save, ways_named
from egolane_pgm.maps.stored import check_path
from egolane_pgm.tools.files import check_not_read, check_place
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, StrPath
from egolane_pgm.views.lane_map import lane_map_figure
from egolane_pgm.views.style import check_figure_path, write_figure

EXAMPLES = ("egolane map roads.osm.pbf -o lanes.parquet --plot lanes.png",)


def map(
    file: StrPath,
    *,
    out: Annotated[StrPath | None, Option("FILE", names=("-o",))] = None,
    plot: Annotated[StrPath | None, Option("FILE")] = None,
    around: Annotated[tuple[float, float, float] | None, Option("LAT LON METRES")] = None,
    drives_left: Annotated[bool | None, Option(names=("--drives-left/--drives-right",))] = None,
) -> LaneGraph:
    """The lanes of the motorways and trunk roads of an extract of OpenStreetMap (.osm, .osm.pbf),
    and how they continue from one segment of a road to the next.

    Take the roads out of a large extract first:
    osmium tags-filter FILE w/highway=motorway,motorway_link,trunk,trunk_link -o ROADS.osm.pbf

    - out: write the lanes, a .parquet file.
    - plot: draw the lanes (.png, .svg, .pdf).
    - around: plot only what lies so near, to scale, lanes numbered.
    - drives_left: the side of traffic; by default as the carriageways of the motorways lie.

    Returns the lanes. Raises InputError, one line, for whatever does not fit.
    """
    lanes, figure = (None if each is None else Path(each) for each in (out, plot))
    if lanes is not None:
        check_path(lanes, "lane graph")
        check_place(lanes)
        check_not_read(lanes, [Path(file)])
    if figure is not None:
        check_figure_path(figure)
        check_place(figure)
    elif around is not None:
        raise InputError("around: needs plot")
    graph = load_map(Path(file), drives_left=drives_left)
    if lanes is not None:
        save(graph, lanes)
    if figure is not None:
        write_figure(partial(lane_map_figure, graph, around), figure)
    return graph


def says(done: LaneGraph, given: Mapping[str, Any]) -> str:
    """What is on the map, and the files that were written."""
    n_lanes = done.n_lanes
    km = [
        f"{done.length_m[n_lanes == n].sum() / 1000:.1f} km with {n or 'an unknown number'}"
        for n in np.unique(n_lanes)
    ]
    kinds = [f"{(done.join == join).sum()} {join}" for join in np.unique(done.join)]
    sources = [
        f"{(done.source == source).sum()} {source or 'unknown'}"
        for source in np.unique(done.source)
    ]
    untold = done.way[n_lanes == 0]
    if len(untold):
        km[0] += f" ({ways_named(untold)})"
    lines = [
        f"{len(done)} segments, {done.length_m.sum() / 1000:.1f} km of carriageway"
        " (© OpenStreetMap contributors, ODbL)",
        f"lanes: {', '.join(km)}",
        f"joins: {len(done.join)} ({', '.join(kinds)})",
        f"shifts of lanes, by source: {', '.join(sources)}",
    ]
    return "\n".join([*lines, *(given[key] for key in ("out", "plot") if given[key])])
