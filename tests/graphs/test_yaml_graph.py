"""Graphs that are written in YAML alone."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.contracts import Graph
from egolane_pgm.graphs.cpds import declare
from egolane_pgm.plugins import load_plugin
from egolane_pgm.types import InputError
from tests.conformance.networks import (
    METHODS,
    assert_filters_agree,
    brute_force,
    compiled_graph,
    draw_evidence,
    tables_of,
)
from tests.kits.drives import run, with_changes

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"

#: The least that a graph has to say.
SMALL = """
nodes: {Lane: 2, Seen: 2}
hidden: [Lane]
observed: [Seen]
tables:
  Lane:
    first: {rows: {values: [0.5, 0.5]}}
    next: {rows: {of: [Lane before], values: [[0.9, 0.1], [0.2, 0.8]]}}
  Seen: {rows: {of: [Lane], values: [[1, 0], [0, 1]]}}
"""

#: Every YAML graph that is shipped, or that a page of results was made with.
SHIPPED = [
    path
    for folder in ("examples", "experiments", "results")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
    if "nodes:" in path.read_text(encoding="utf-8")
]


def load(folder: Path, text: str) -> Graph:
    (folder / "g.yaml").write_text(textwrap.dedent(text))
    return load_plugin(Graph, str(folder / "g.yaml"), "graph")


def changed(**changes: Any) -> str:
    """SMALL with other keys; `tables__Seen` for a key below a section; None takes one out."""
    return str(yaml.safe_dump(with_changes(yaml.safe_load(SMALL), changes)))


def refusal(folder: Path, text: str) -> str:
    def declared() -> None:
        module = load(folder, text)
        declare(tables_of(module, 2, {}), module.observed)

    with pytest.raises(InputError) as caught:
        declared()
    return str(caught.value)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_graph_in_yaml_compiles(path: Path) -> None:
    module = load_plugin(Graph, str(path), "graph")
    n_lanes = next(t for t in tables_of(module, 0, {}) if t.node == ("Lane", 0)).values.size
    assert compiled_graph(module, n_lanes, {}).cardinality["Lane"] == n_lanes


def test_the_example_gives_the_beliefs_of_the_papers_graph() -> None:
    ours = run(EXAMPLES / "yaml_graph.yaml")
    right = run(EXAMPLES / "yaml_graph.yaml", graph="sensor_failure")
    np.testing.assert_allclose(ours.node("Lane"), right.node("Lane"), atol=1e-3)
    assert ours.scores["model"]["accuracy"] > ours.scores["detector"]["accuracy"]


def test_the_numbers_stand_in_the_order_of_the_parents(tmp_path: Path) -> None:
    module = load(
        tmp_path,
        """
        description: all that a file may say
        nodes: {Lane: 2, S: [A, B], D: 2, E: 3}
        hidden: [Lane, S]
        observed: [[D, S], E]
        unused: [WOR, [X, Y]]
        tables:
          Lane:
            first: {rows: {values: [0.25, 0.75]}}
            next:
              rows:
                of: [S before, Lane before]
                values: [[[1, 0], [0, 1]], [[0.75, 0.25], [0.5, 0.5]]]
          S:
            first: {rows: {values: [0.5, 0.5]}}
            next: {rows: {of: [S before], values: [[0.75, 0.25], [0.1, 0.9]]}}
          D: {rows: {of: [S, Lane], values: [[[1, 0], [0, 1]], [[0.2, 0.8], [0.3, 0.7]]]}}
          E: {rows: {of: [S], values: [[0.2, 0.3, 0.5], [0, 0, 1]]}}
        """,
    )
    assert (module.about, module.parameters) == ("all that a file may say", ())
    assert (module.values, module.unused) == ({"S": ("A", "B")}, ("WOR", ("X", "Y")))
    tables = {table.node: table for table in tables_of(module, 2, {})}
    assert tables["Lane", 1].parents == (("S", 0), ("Lane", 0))
    np.testing.assert_array_equal(tables["Lane", 1].values[1], [[0.75, 0.25], [0.5, 0.5]])
    for s in (0, 1):
        assert tables["D", s].parents == (("S", s), ("Lane", s))
        np.testing.assert_array_equal(tables["D", s].values[1], [[0.2, 0.8], [0.3, 0.7]])
    network = compiled_graph(module, 2, {})
    evidence = draw_evidence(network, 2, np.random.default_rng(0))
    for method in METHODS:
        right = brute_force(tables_of(module, 2, {}), module.hidden, evidence, method)
        assert_filters_agree(network, evidence, {method: right})


def test_an_input_node_needs_no_table_and_selects_the_transition(tmp_path: Path) -> None:
    module = load(
        tmp_path,
        """
        nodes: {Lane: 2, InputSpeed: [slow, fast], Seen: 2}
        hidden: [Lane]
        observed: [Seen]
        inputs: [InputSpeed]
        tables:
          Lane:
            first: {rows: {of: [InputSpeed], values: [[0.5, 0.5], [0.5, 0.5]]}}
            next:
              rows:
                of: [InputSpeed, Lane before]
                values: [[[1, 0], [0, 1]], [[0.6, 0.4], [0.3, 0.7]]]
          Seen: {rows: {of: [Lane], values: [[1, 0], [0, 1]]}}
        """,
    )
    network = compiled_graph(module, 2, {})
    assert network.inputs == ("InputSpeed",)
    np.testing.assert_allclose(network.transition, [np.eye(2), [[0.6, 0.4], [0.3, 0.7]]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1, 2]", "needs keys and values"),
        ("a: [", "is not YAML"),
        (changed(nods={}), "unknown key 'nods' (did you mean 'nodes'?)"),
        (changed(parameters={"s": 1}), "unknown key 'parameters'"),
        (changed(hidden=None), "hidden: is missing"),
        (changed(hidden=["Lan"]), "hidden: no node 'Lan' (did you mean 'Lane'?)"),
        (changed(hidden="Lane"), "hidden: needs a list (got 'Lane')"),
        (changed(unused=5), "unused: needs a list (got 5)"),
        (changed(observed=[["Seen", "Sen"]]), "observed: no node 'Sen' (did you mean 'Seen'?)"),
        (changed(inputs=["X"]), "inputs: no node 'X' (known: Lane, Seen)"),
        (changed(nodes=[]), "nodes: needs keys and values"),
        (changed(nodes__Lane="n_lanes"), "nodes.Lane: needs a number of values, or a list of"),
        (changed(nodes__Lane=True), "nodes.Lane: needs a number of values, or a list of their"),
        (changed(tables__Seen=None), "tables.Seen: is missing"),
        (changed(tables__Sen={"rows": {}}), "tables: unknown key 'Sen' (did you mean 'Seen'?)"),
        (changed(tables__Seen="uniform"), "tables.Seen: needs keys and values"),
        (changed(tables__Lane={"rows": {"of": ["Lane before"], "values": []}}), "under `next`"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_together_is_refused_by_its_name_and_key(
    tmp_path: Path, text: str, said: str
) -> None:
    line = refusal(tmp_path, text)
    assert said in line
    assert line.startswith("graph: ")
    assert "g.yaml: " in line


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ({"normal": {}}, "tables.Seen: unknown key 'normal'"),
        ({"rows": {"of": "Lane", "values": [1]}}, "tables.Seen: rows.of: needs a list (got 'Lan"),
        ({"rows": {"of": ["Lan"], "values": [1]}}, "tables.Seen: of: no node 'Lan' (did you mean"),
        ({"rows": {"of": ["Lane"]}}, "tables.Seen: rows.values: is missing"),
        ({"rows": {"of": ["Lane"], "values": [[1, 0]]}}, "needs 2 x 2 numbers, has 1 x 2"),
        ({"rows": {"of": ["Lane"], "values": [[1], [0, 1]]}}, "needs 2 x 2 numbers, has others"),
        ({"rows": {"of": ["Lane"], "values": [[1, 1], [0, 1]]}}, "rows of the table must sum to"),
        ({"first": {"rows": {"values": [1, 0]}}}, "tables.Seen: next: is missing"),
    ],
)  # fmt: skip
def test_a_table_that_does_not_fit_is_refused_naming_node_and_parent(
    tmp_path: Path, seen: Any, said: str
) -> None:
    line = refusal(tmp_path, changed(tables__Seen=seen))
    assert said in line
    assert line.startswith("graph: g.yaml: ")
