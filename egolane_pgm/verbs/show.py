"""The verb `show`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

from annotated_types import Ge, Le

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.model import Roles, build_network, compile_graph, fitting_rule, graph_roles
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.plugins import find_plugin, load_plugin
from egolane_pgm.recordings import format_of
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.types import MAX_LANES, InputError
from egolane_pgm.verbs.given import Option, StrPath, path_of, shown
from egolane_pgm.views.description import (
    describe_detector,
    describe_graph,
    describe_rule,
    description_text,
)

EXAMPLES = ("egolane show sensor_failure --tables", "egolane show drive.csv")

NLanes = Annotated[int, Ge(1), Le(MAX_LANES)]

#: What `show` knows, and the folder of each.
_KINDS = {"graph": "graphs", "evidence": "evidence", "detector": "detectors"}


def show(
    name: Annotated[
        StrPath, Option("GRAPH|EVIDENCE|DETECTOR|FILE", plugins=("graphs", "evidence", "detectors"))
    ],
    *,
    n_lanes: NLanes = 3,
    tables: bool = False,
) -> dict[str, Any]:
    """Show what a graph, an evidence rule or a detector is: nodes, edges, tables, parameters.

    NAME is one of `egolane ls`, or a file of your own; `graph:NAME`, `evidence:NAME` or
    `detector:NAME` says which where it is not clear. Of a recording, a table or a bag, show what is
    in it and, where that is plain, the command that runs it.

    - n_lanes: number of lanes of the road.
    - tables: print a graph's tables in numbers.

    Returns its description. Raises InputError, one line, for whatever does not fit.
    """
    if _is_recording(Path(path_of(name, "name"))):
        from egolane_pgm.recordings.showing import show_recording

        return {
            "schema_version": SCHEMA_VERSION,
            "name": str(name),
            "text": show_recording(Path(name)),
        }
    kind, bare = find_plugin(path_of(name, "name"), _KINDS, Path.cwd())
    module = load_plugin(_KINDS[kind], bare, Path.cwd(), kind)
    found: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "name": bare}
    if kind == "graph":
        return found | describe_graph(
            module, compile_defaults(bare, module, n_lanes), numbers=tables
        )
    if kind == "evidence":
        return found | describe_rule(module, _defaults(module, n_lanes))
    return found | describe_detector(module)


def says(done: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """The description as text."""
    if "text" in done:
        return str(done["text"])
    return description_text({**done, "file": shown(done["file"])})


def _is_recording(path: Path) -> bool:
    """Whether a name is that of a table or a bag."""
    try:
        return format_of(path) in ("table", "rosbag")
    except InputError:
        return False


def compile_defaults(name: str, module: ModuleType, n_lanes: int) -> Compiled:
    """A graph with the default values of its parameters."""
    where = f"graph {name}"
    try:
        declared = build_network(module, n_lanes, _defaults(module, n_lanes), where)
        rule = fitting_rule(module, n_lanes, "counting", Path.cwd(), where)
        try:
            roles = graph_roles(module, load_plugin("evidence", rule, Path.cwd(), where), declared)
        except InputError:
            # A rule of one's own may give what none of the package gives.
            roles = Roles(None, (), (), ())
        return compile_graph(module, roles, declared)
    except InputError as error:
        raise InputError(str(error) if where in str(error) else f"{where}: {error}") from error


def _defaults(module: ModuleType, n_lanes: int) -> Parameters:
    return resolve_parameters(getattr(module, "PARAMETERS", ()), {}, n_lanes)
