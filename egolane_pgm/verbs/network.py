"""The verb `network`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from egolane_pgm.plugins import load_plugin
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.verbs.given import Option, StrPath, path_of
from egolane_pgm.verbs.show import NLanes, compile_defaults
from egolane_pgm.views.network import check_ending, write_network

EXAMPLES = ("egolane network sensor_failure graph.svg",)


def network(
    graph: Annotated[StrPath, Option(plugins=("graphs",))], target: StrPath, *, n_lanes: NLanes = 3
) -> str:
    """Write a graph (a name, or a file of your own), two slices: a picture (.png, .svg, .pdf), text
    for Graphviz (.dot), or its tables for other programs (.bif).

    - n_lanes: number of lanes of the road.

    Returns the name of the file. Raises InputError, one line, for whatever does not fit.
    """
    name, file = path_of(graph, "graph"), path_of(target, "target")
    check_ending(file)
    check_not_read(Path(file), [Path(name)])
    module = load_plugin("graphs", name, Path.cwd(), "graph")
    write_network(compile_defaults(name, module, n_lanes), file)
    return file
