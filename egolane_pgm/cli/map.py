"""The command `egolane map`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click
import numpy as np

from egolane_pgm.maps import load_map
from egolane_pgm.maps.lane_graph import LaneGraph, check_lanes_path, save
from egolane_pgm.report.lane_map import lane_map_figure
from egolane_pgm.report.style import check_figure_path, write_figure
from egolane_pgm.tools.files import check_not_read, check_place
from egolane_pgm.types import InputError


@click.command()
@click.argument("file", type=click.Path(dir_okay=False), metavar="FILE")
@click.option("-o", "--out", metavar="FILE", help="Write the lanes, a .parquet file.")
@click.option("--plot", metavar="FILE", help="Draw the lanes (.png, .svg, .pdf).")
@click.option(
    "--around",
    type=(float, float, float),
    metavar="LAT LON METRES",
    help="With --plot: only what lies so near, to scale, lanes numbered.",
)
@click.option(
    "--drives-left/--drives-right",
    default=None,
    help="The side of traffic; by default as the carriageways of the motorways lie.",
)
def map(
    file: str,
    out: str | None,
    plot: str | None,
    around: tuple[float, float, float] | None,
    drives_left: bool | None,
) -> None:
    """The lanes of the motorways and trunk roads of an extract of OpenStreetMap (.osm, .osm.pbf),
    and how they continue from one segment of a road to the next.

    Take the roads out of a large extract first:
    osmium tags-filter FILE w/highway=motorway,motorway_link,trunk,trunk_link -o ROADS.osm.pbf
    """
    if out is not None:
        check_lanes_path(out)
        check_place(Path(out))
        check_not_read(Path(out), [Path(file)])
    if plot is not None:
        check_figure_path(plot)
        check_place(Path(plot))
    elif around is not None:
        raise InputError("--around: needs --plot")
    graph = load_map(file, drives_left=drives_left)
    click.echo(described(graph))
    if out is not None:
        save(graph, out)
        click.echo(out)
    if plot is not None:
        write_figure(partial(lane_map_figure, graph, around), plot)
        click.echo(plot)


def described(graph: LaneGraph) -> str:
    """What is on a map, in a few lines."""
    n_lanes = graph.n_lanes
    km = [
        f"{graph.length_m[n_lanes == n].sum() / 1000:.1f} km with {n or 'an unknown number of'}"
        for n in np.unique(n_lanes)
    ]
    kinds = [f"{(graph.join == join).sum()} {join}" for join in np.unique(graph.join)]
    sources = [
        f"{(graph.source == source).sum()} {source or 'unknown'}"
        for source in np.unique(graph.source)
    ]
    return "\n".join(
        [
            f"{len(graph)} segments, {graph.length_m.sum() / 1000:.1f} km of carriageway"
            " (© OpenStreetMap contributors, ODbL)",
            f"lanes: {', '.join(km)}",
            f"joins: {len(graph.join)} ({', '.join(kinds)})",
            f"shifts of lanes, by source: {', '.join(sources)}",
        ]
    )
