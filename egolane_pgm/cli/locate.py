"""The command `egolane locate`: which road of a map a car was on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from egolane_pgm.cli import options
from egolane_pgm.maps import load_map, road_table
from egolane_pgm.maps.index import index_of
from egolane_pgm.maps.locating import locate as locate_on
from egolane_pgm.maps.lock_on_road import lock_on_road
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.maps.stored import check_path
from egolane_pgm.tools.files import check_not_read, check_place


@click.command()
@click.argument("map_file", metavar="MAP", type=click.Path(dir_okay=False))
@click.argument("positions_file", metavar="POSITIONS", type=click.Path(dir_okay=False))
@click.option("-o", "--out", required=True, metavar="FILE", help="The road table, .parquet.")
@click.option("--online", is_flag=True, help="Each row knows the positions before it only.")
@click.option(
    "--method",
    type=click.Choice(["hmm", "lock-on-road"]),
    default="hmm",
    show_default=True,
    help="Map matching, or the authors' nearest road, the baseline.",
)
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="OURS=THEIRS",
    help="A table's column of another name, e.g. latitude=lat_gps.",
)
@click.option("--topic", help="Topic of a bag.")
@click.option(
    "--shift",
    "shift_s",
    type=float,
    default=0.0,
    show_default=True,
    metavar="SECONDS",
    help="Added to the positions' times, to have the clock of a recording of lines.",
)
def locate(
    map_file: str,
    positions_file: str,
    out: str,
    online: bool,
    method: str,
    columns: tuple[str, ...],
    topic: str | None,
    shift_s: float,
) -> None:
    """Find the road of a car: segment, place on it, lanes, what is ahead, and how sure that is.

    MAP is what `egolane map` writes, or an extract itself. POSITIONS is a .csv, .parquet, .gpx,
    .nmea or .bag of a GNSS receiver. Experiments with `n_lanes: map` read the road table.
    """
    check_path(out, "road table")
    check_place(Path(out))
    check_not_read(Path(out), [Path(map_file), Path(positions_file)])
    named = {k: str(v) for k, v in options.given(columns, "latitude=lat_gps", "--column").items()}
    graph = load_map(map_file)
    positions = read_positions(positions_file, columns=named, topic=topic)
    positions = replace(positions, t_s=positions.t_s + shift_s)
    index = index_of(graph)
    matched = lock_on_road(index, positions) if method == "lock-on-road" else None
    table = locate_on(graph, index, positions, online=online, matched=matched)
    road_table.save(table, out)
    on = table.segment >= 0
    off_by = np.abs(table.offset_m[np.isfinite(table.offset_m)])
    n_lanes = np.unique(table.n_lanes[on & (table.n_lanes > 0)])
    click.echo(
        f"{out}: {len(table)} rows, {table.t_s[0]:g} to {table.t_s[-1]:g} s,"
        f" {on.mean():.1%} on the map"
    )
    click.echo(
        f"{len(positions)} positions; half of them within {np.median(off_by):.1f} m of the way's"
        f" line; lanes: {', '.join(map(str, n_lanes)) or 'unknown'};"
        f" mean probability of the segment {table.sure[on].mean():.3f}"
    )
