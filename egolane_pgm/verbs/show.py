"""The verb `show`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import click
from annotated_types import Ge, Le

from egolane_pgm.contracts import Detector, Graph, Plugin, Rule
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.loading import experiments_folder, load_yaml
from egolane_pgm.model import compile_graph, matching_evidence_rule
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.plugins import OWN_FILES, find_plugin, load_plugin, plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.recordings.showing import show_recording
from egolane_pgm.simulation import PRESETS
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.tools.options import Option, StrPath
from egolane_pgm.types import MAX_LANES, InputError, problems_in, suggestion
from egolane_pgm.views.description import (
    describe_detector,
    describe_graph,
    describe_rule,
    description_text,
)
from egolane_pgm.views.heat_maps import tables_figure
from egolane_pgm.views.network import write_network
from egolane_pgm.views.style import write_figure
from egolane_pgm.views.tables import line_width
from egolane_pgm.vision.detectors.networks.description import ready_networks

EXAMPLES = (
    "egolane show",
    "egolane show sensor_failure --numbers",
    "egolane show sensor_failure --out network.png",
    "egolane show sensor_failure --numbers --out tables.png",
    "egolane show drive.csv",
    "egolane show lstr_360x640.onnx",
    "egolane show schema > experiment.schema.json",
)

#: The plugins that are described.
_PLUGINS: dict[str, type[Plugin]] = {"graph": Graph, "evidence": Rule, "detector": Detector}

#: Names of each kind, or descriptions of files by path.
_KINDS: dict[str, Callable[[], list[str] | dict[str, str]]] = {
    "graphs": lambda: plugin_names(Graph),
    "evidence": lambda: plugin_names(Rule),
    "detectors": lambda: plugin_names(Detector),
    "networks": lambda: [*ready_networks()],
    "recordings": lambda: [*FORMATS],
    "simulations": lambda: sorted(PRESETS),
    "experiments": lambda: _descriptions("experiments"),
    "tuning": lambda: _descriptions("tuning"),
}


def show(
    name: Annotated[StrPath | None, Option("[NAME|FILE|KIND]")] = None,
    *,
    n_lanes: Annotated[int, Ge(1), Le(MAX_LANES)] = 3,
    numbers: bool = False,
    out: Annotated[StrPath | None, Option("FILE")] = None,
) -> dict[str, Any]:
    """List graphs, evidence rules, detectors and experiments, or describe a plugin or a file.

    Without NAME, or with a KIND (graphs, evidence, detectors, experiments, ...), the names are
    listed. NAME is a graph, an evidence rule or a detector, or your own file. A prefix
    distinguishes equal names: `graph:NAME`, `evidence:NAME`, `detector:NAME`. `schema` and
    `schema:tuning` print the JSON Schemas of experiments and tuning files.

    For a recording (a table or a bag), print its content and, if names and signs are clear, the
    command that runs it. For a lane network (FILE.onnx), print its inputs, its outputs and the
    layouts that fit.

    - n_lanes: number of lanes of the road.
    - numbers: print a graph's tables; with `out`, draw them as heat maps.
    - out: write a graph: a picture (.png, .svg, .pdf), or both slices with their tables for
      other programs (.bif).

    Returns the description. Raises InputError if the arguments do not fit.
    """
    given = "" if name is None else str(name)
    if not given or given in _KINDS:
        found: dict[str, Any] = {kind: _KINDS[kind]() for kind in ([given] if given else _KINDS)}
    elif given.partition(":")[0] == "schema":
        # Schemas import all rooms that have one.
        from egolane_pgm.verbs.schema import KINDS, schema

        kind = given.partition(":")[2] or "experiment"
        if kind not in KINDS:
            raise InputError(f"schema:{kind}: unknown kind{suggestion(kind, KINDS)}")
        found = schema(kind)
    elif given.endswith(".onnx"):
        # OpenCV is imported only if it is needed.
        from egolane_pgm.vision.detectors.networks.checking import describe_onnx

        found = {"name": given, "text": describe_onnx(Path(given))}
    elif os.path.exists(given) and not given.endswith(OWN_FILES):
        found = {"name": given, "text": show_recording(Path(given))}
    else:
        found = _plugin(given, n_lanes, numbers, out)
    if out is not None and found.get("kind") != "graph":
        raise InputError(f"out: {out}: only a graph is written to a file")
    return found


def summary(done: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """The description as text, or the name of the file that was written."""
    if given.get("out") is not None:
        return str(given["out"])
    if "text" in done:
        return str(done["text"])
    if "$schema" in done:
        return json.dumps(done, indent=1)
    if "kind" in done:
        return description_text({**done, "file": _shown(done["file"])})
    text = click.HelpFormatter(width=line_width())
    names = {f"{kind}:": ", ".join(each) for kind, each in done.items() if isinstance(each, list)}
    if names:
        text.write_dl([*names.items()])
    for kind in sorted(kind for kind, each in done.items() if isinstance(each, dict)):
        with text.section(kind):
            text.write_dl([*done[kind].items()], col_max=4)
    return text.getvalue().rstrip("\n")


def _descriptions(kind: str) -> dict[str, str]:
    """The description of each shipped experiment, or of each tuning file, by its path."""
    return {
        _shown(path): load_yaml(path).get("description", "")
        for path in sorted(experiments_folder().rglob("*.yaml"))
        if path.name[0] != "_" and path.name != "published.yaml"
        if (path.parent.name == "tuning") == (kind == "tuning")
    }


def _shown(path: str | Path) -> str:
    """A path for printing: relative if it is below the current folder."""
    here = Path.cwd()
    return str(Path(path).relative_to(here) if Path(path).is_relative_to(here) else path)


def _plugin(name: str, n_lanes: int, numbers: bool, out: StrPath | None) -> dict[str, Any]:
    """The description of a plugin; a graph is also written to `out`."""
    kind, bare = find_plugin(name, _PLUGINS)
    if out is not None:
        check_not_read(Path(out), [Path(bare)])
    found: dict[str, Any] = {"name": bare}
    if kind == "evidence":
        rule = load_plugin(Rule, bare, kind)
        return found | describe_rule(rule, _defaults(rule, n_lanes))
    if kind == "detector":
        return found | describe_detector(load_plugin(Detector, bare, kind))
    graph = load_plugin(Graph, bare, kind)
    compiled = compile_defaults(bare, graph, n_lanes)
    if out is not None and numbers and Path(out).suffix.lower() != ".bif":
        write_figure(lambda: tables_figure(compiled), Path(out))
    elif out is not None:
        write_network(compiled, Path(out))
    return found | describe_graph(graph, compiled, numbers=numbers)


def compile_defaults(name: str, graph: Graph, n_lanes: int) -> Compiled:
    """A graph with the default values of its parameters."""
    where = f"graph {name}"
    parameters = _defaults(graph, n_lanes)
    with problems_in(where):
        rule = matching_evidence_rule(graph, n_lanes, "counting", where)
        evidence = load_plugin(Rule, rule, where)
        return compile_graph(evidence, graph, n_lanes, parameters)[0]


def _defaults(plugin: Graph | Rule, n_lanes: int) -> Parameters:
    return resolve_parameters(plugin.parameters, {}, n_lanes)
