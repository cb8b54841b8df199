"""The command `egolane network`."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.cli.completion import plugins
from egolane_pgm.cli.show import compile_defaults
from egolane_pgm.plugins import load_plugin
from egolane_pgm.report.network import check_ending, write_network
from egolane_pgm.tools.files import check_not_read


@click.command()
@click.argument("graph", shell_complete=plugins("graphs"))
@click.argument("target", type=click.Path(dir_okay=False))
@options.n_lanes
def network(graph: str, target: str, n_lanes: int) -> None:
    """Write a graph (a name, or a file of your own), two slices: a picture (.png, .svg, .pdf), text
    for Graphviz (.dot), or its tables for other programs (.bif)."""
    check_ending(target)
    check_not_read(Path(target), [Path(graph)])
    module = load_plugin("graphs", graph, Path.cwd(), "graph")
    write_network(compile_defaults(graph, module, n_lanes), target)
    click.echo(target)
