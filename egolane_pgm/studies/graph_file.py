"""A graph written as YAML with its tables in numbers, as `graphs.yaml_graph` reads it; so also one
that is in memory."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

from egolane_pgm.experiment import Experiment
from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import LANES
from egolane_pgm.model import Model, compile_graph, matching_evidence_rule
from egolane_pgm.plugins import OWN_FILES, load_plugin
from egolane_pgm.tools.files import write_yaml
from egolane_pgm.types import InputError, problems_in


def graph_named(graph: Any, experiment: Experiment) -> str:
    """The value of the key `graph` for a graph of any kind: a name or an absolute path.

    - graph: a name, a file, a module, a network of pgmpy, or anything with a model (a result, a
      study, an exploration). A network or model is written as a YAML graph in numbers to a folder
      that stays until this process ends; a result has a copy.
    - experiment: its evidence rule, or the one that fits the network, defines what is observed.

    Raises InputError for anything else, and for a network that cannot be compiled.
    """
    if isinstance(graph, (str, os.PathLike)):
        name = os.fspath(graph)
        return os.path.abspath(name) if name.endswith(OWN_FILES) else name
    if isinstance(graph, ModuleType):
        if graph.__name__.startswith("egolane_pgm.graphs."):
            return graph.__name__.rpartition(".")[2]
        if not str(getattr(graph, "__file__", "")).endswith(OWN_FILES):
            raise InputError(f"graph: the module {graph.__name__} has no file; write it to one")
        return os.path.abspath(str(graph.__file__))
    if isinstance(model := getattr(graph, "model", graph), Model):
        # Parameters without fitted tables may have been tuned on any frames.
        origin = "unknown" if model.learned_from is None else model.learned_from
        return _written(replace(model, learned_from=origin), "the graph of a model in memory")
    if not hasattr(graph, "get_cpds"):
        kind = type(graph).__name__
        raise InputError(f"graph: {kind} is no name, file or module, and no network of pgmpy")
    module = ModuleType("network")
    vars(module)["build"] = lambda n_lanes, parameters: graph
    n_lanes = experiment.n_lanes
    with problems_in("graph"):
        evidence = matching_evidence_rule(module, n_lanes, experiment.evidence, "network")
        rule = load_plugin("evidence", evidence, "evidence")
        compiled, unused = compile_graph(rule, module, n_lanes, {})
    origin = graph.graph.get("learned_from", "unknown")
    model = Model(experiment, rule, module, {}, compiled, unused, origin)
    return _written(model, "a network of pgmpy that was in memory")


def _written(model: Model, description: str) -> str:
    """Write a graph to the folder of this process; return its path."""
    content = graph_yaml(model, description)
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:12]
    file = Path(_folder().name, f"network_{digest}.yaml")
    write_yaml(file, content)
    return str(file)


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Where networks in memory are written; it is deleted when this process ends."""
    return tempfile.TemporaryDirectory(prefix="egolane_")


def graph_yaml(model: Model, description: str) -> dict[str, Any]:
    """The keys of a YAML graph with the nodes of the model's graph and its tables.

    It is for the model's number of lanes only, and has no parameters.
    """
    compiled = model.compiled
    by_node = compiled.tables
    names = list(dict.fromkeys(name for name, _ in by_node))
    nodes: dict[str, int | list[str]] = {}
    for name in names:
        values, first = compiled.values[name], int(name in LANES)
        are_default = values == tuple(map(str, range(first, first + len(values))))
        nodes[name] = len(values) if are_default else list(values)
    content: dict[str, Any] = {
        "description": description,
        "learned_from": model.learned_from,
        "nodes": nodes,
        "hidden": list(compiled.hidden),
        "observed": [list(key) if isinstance(key, tuple) else key for key in compiled.observed],
        "inputs": list(compiled.inputs),
        "bounds": {k: list(v) for k, v in getattr(model.graph, "BOUNDS", {}).items()},
        "unused": [list(k) if isinstance(k, tuple) else k for k in sorted(model.unused, key=str)],
        "tables": {
            name: _rows(by_node[name, 1])
            if name in compiled.one_table
            else {"first": _rows(by_node[name, 0]), "next": _rows(by_node[name, 1])}
            for name in names
            if name not in compiled.inputs
        },
    }
    return {key: value for key, value in content.items() if value not in ([], {}, None)}


def _rows(table: Table) -> dict[str, Any]:
    of = [name if t == table.node[1] else f"{name} before" for name, t in table.parents]
    return {"rows": {**({"of": of} if of else {}), "values": table.values.tolist()}}
