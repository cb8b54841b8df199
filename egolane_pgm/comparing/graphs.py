"""Graphs that are put into experiments: found from where one stands, and named."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from pathlib import Path

from egolane_pgm.experiment import Experiment
from egolane_pgm.model import fitting_rule
from egolane_pgm.plugins import OWN_FILES, declared_parameters, load_plugin
from egolane_pgm.types import InputError


def named_graphs(graphs: Sequence[str]) -> dict[str, str]:
    """Graphs by the names that tables and directories have for them.

    graphs: names of the package's, or files, from where one stands.

    A file is called by its stem, with the name of its folder where two have the same one, and is
    given in full. Raises InputError for a graph that is named twice.
    """
    full = [os.path.abspath(graph) if graph.endswith(OWN_FILES) else graph for graph in graphs]
    stems = [Path(graph).stem if graph.endswith(OWN_FILES) else graph for graph in full]
    found: dict[str, str] = {}
    for graph, stem in zip(full, stems, strict=True):
        if graph in found.values():
            raise InputError(f"graphs: {graph} is named twice")
        if stems.count(stem) > 1 and graph != stem:
            stem = f"{Path(graph).parent.name}_{stem}"
        title = re.sub(r"[^A-Za-z0-9._-]+", "_", stem).strip("._-") or "graph"
        numbered = (f"{title}_{k}" for k in itertools.count(2))
        found[next(t for t in itertools.chain([title], numbered) if t not in found)] = graph
    return found


def with_graphs(
    models: Sequence[Experiment],
    graphs: Sequence[str],
    *,
    is_shared: bool = False,
) -> list[Experiment]:
    """Each model once with each graph, as `with_graph` puts it there.

    graphs: as `named_graphs` takes them, after which the new experiments are named.
    is_shared: whether several models share a recording; the experiments are named after the model
        too then.

    Raises InputError for a graph that is not there.
    """
    named = named_graphs(graphs)
    found = []
    for model, (name, graph) in itertools.product(models, named.items()):
        title = f"{model.name}_{name}" if is_shared else name
        found.append(with_graph(model, graph).model_copy(update={"name": title}))
    return found


def with_graph(experiment: Experiment, graph: str) -> Experiment:
    """The experiment with another graph.

    It keeps those of its parameters that the new plugins declare, and its evidence rule where that
    gives what the graph observes; else it has the first rule that does.
    """
    folder, source = experiment.folder, experiment.source
    module = load_plugin("graphs", graph, folder, "graphs")
    evidence = fitting_rule(module, experiment.n_lanes, experiment.evidence, folder, source)
    rule = load_plugin("evidence", evidence, folder, f"{source}: evidence")
    known = {spec.name for spec in declared_parameters(rule, module)}
    kept = {name: value for name, value in experiment.parameters.items() if name in known}
    changed = {"graph": graph, "evidence": evidence, "parameters": kept}
    return experiment.model_copy(update=changed)
