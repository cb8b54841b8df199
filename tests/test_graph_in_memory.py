"""Graphs written as YAML with their tables in numbers are read as they were written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.contracts import Graph, Rule
from egolane_pgm.inference.compile import Compiled, compile_tables
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import Model, graph_in_memory
from egolane_pgm.plugins import load_plugin
from egolane_pgm.studies.fits import apply_fit, fit_learn
from egolane_pgm.tools.files import write_yaml
from tests.conformance.networks import draw_graph, graph_names, tables_of
from tests.conftest import needs_compiler
from tests.kits.drives import simulated, write_drive
from tests.kits.studies import drive_of

DISCRETE = [name for name in graph_names() if not name.startswith("position_in")]


def read_back(model: Model, file: Path) -> tuple[Compiled, Graph]:
    """The network of the file that a model's graph is written to, and the graph in it."""
    write_yaml(file, graph_in_memory(model, "unknown").keys or {})
    graph = load_plugin(Graph, str(file), "graph")
    assert graph.hidden
    assert graph.observed
    roles: Any = {"hidden": graph.hidden, "observed": graph.observed, "inputs": graph.inputs}
    return compile_tables(tables_of(graph, model.n_lanes, {}), **roles), graph


def assert_same(ours: Compiled, theirs: Compiled) -> None:
    np.testing.assert_allclose(ours.prior, theirs.prior, rtol=1e-9, atol=0)
    np.testing.assert_allclose(ours.transition, theirs.transition, rtol=1e-9, atol=0)
    for mine, right in zip(ours.groups, theirs.groups, strict=True):
        assert mine.observed == right.observed
        np.testing.assert_allclose(mine.emission, right.emission, rtol=1e-9, atol=0)


@needs_compiler
@pytest.mark.parametrize("name", DISCRETE)
def test_every_discrete_graph_can_be_learned_and_written(name: str, tmp_path: Path) -> None:
    drive = drive_of(load_experiment(write_drive(tmp_path, 200, graph=name)))
    fitted = fit_learn([drive], [np.arange(len(drive))], None)
    assert fitted
    learned = apply_fit(drive.model, fitted)
    assert (learned.compiled.transition != drive.model.compiled.transition).any()
    read, graph = read_back(learned, tmp_path / "g.yaml")
    assert_same(read, learned.compiled)
    own = drive.model.graph
    assert (graph.hidden, graph.observed, graph.unused) == (own.hidden, own.observed, own.unused)
    assert graph.values == (own.values or {})


@pytest.mark.parametrize("seed", range(8))
def test_random_graphs_come_back_from_their_file(seed: int, tmp_path: Path) -> None:
    """Inputs, functions and joint evidence too; a graph of one's own may have all of them."""
    compiled = draw_graph(np.random.default_rng(seed)).compiled()
    experiment = load_experiment(simulated(), n_lanes=3)
    rule = load_plugin(Rule, "counting", "evidence")
    model = Model(experiment, rule, Graph(name="own"), {}, compiled, frozenset())
    assert_same(read_back(model, tmp_path / "g.yaml")[0], compiled)
