"""Graphs that are written in YAML alone."""

from __future__ import annotations

import textwrap
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.experiment import load_experiment
from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import with_tables
from egolane_pgm.model import prepare_model
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import load_plugin
from egolane_pgm.results import read_result
from egolane_pgm.running import run_experiment
from egolane_pgm.types import InputError
from tests.conformance.networks import (
    METHODS,
    assert_filters_agree,
    brute_force,
    compiled_graph,
    draw_evidence,
    draw_parameters,
    graph,
)
from tests.kits.drives import done, refused, with_changes, write_drive

EXAMPLES = Path(__file__).parents[2] / "examples"

#: The least that a graph has to say.
SMALL = """
nodes: {Lane: n_lanes, Seen: n_lanes}
hidden: [Lane]
observed: [Seen]
edges: {within: [Lane -> Seen], across: [Lane -> Lane]}
parameters: {sigma: {kind: sigma, default: 0.5}}
tables:
  Lane: {first: uniform, next: {normal: {around: Lane before, sigma: sigma}}}
  Seen: {identity: {of: Lane}}
"""


def load(folder: Path, text: str) -> ModuleType:
    (folder / "g.yaml").write_text(textwrap.dedent(text))
    return load_plugin("graphs", "./g.yaml", folder, "graph")


def changed(**changes: Any) -> str:
    """SMALL with other keys; `tables__Seen` for a key below a section; None takes one out."""
    return str(yaml.safe_dump(with_changes(yaml.safe_load(SMALL), changes)))


def table(module: ModuleType, node: tuple[str, int], n_lanes: int = 3, **given: object) -> Table:
    parameters = resolve_parameters(module.PARAMETERS, given, n_lanes)
    return next(t for t in module.tables(n_lanes, parameters) if t.node == node)


@pytest.mark.parametrize("n_lanes", [1, 2, 3, 4, 5])
def test_the_papers_graph_in_yaml_compiles_to_exactly_the_same_arrays(n_lanes: int) -> None:
    ours = load_plugin("graphs", "./sensor_failure.yaml", EXAMPLES, "graph")
    paper = graph("sensor_failure")
    assert [p.name for p in ours.PARAMETERS] == [p.name for p in paper.PARAMETERS]
    for spec, right in zip(ours.PARAMETERS, paper.PARAMETERS, strict=True):
        assert (spec.kind, spec.default, spec.search) == (right.kind, right.default, right.search)
    assert (ours.HIDDEN, ours.OBSERVED, ours.VALUES) == (paper.HIDDEN, paper.OBSERVED, paper.VALUES)
    for seed in range(5):
        parameters = draw_parameters(paper.PARAMETERS, n_lanes, np.random.default_rng(seed))
        right = compiled_graph(paper, n_lanes, parameters)
        for found in (
            compiled_graph(ours, n_lanes, parameters),
            with_tables(right, ours.tables(n_lanes, parameters)),
        ):
            np.testing.assert_array_equal(found.prior, right.prior)
            np.testing.assert_array_equal(found.transition, right.transition)
            assert found.observed == right.observed
            for group, other in zip(found.groups, right.groups, strict=True):
                np.testing.assert_array_equal(group.emission, other.emission)


def test_the_example_gives_the_beliefs_of_the_papers_graph() -> None:
    experiment = load_experiment(EXAMPLES / "yaml_graph.yaml")
    ours = run_experiment(experiment)
    right = run_experiment(experiment.model_copy(update={"graph": "sensor_failure"}))
    np.testing.assert_array_equal(ours.beliefs.lane, right.beliefs.lane)
    assert ours.scores["model"]["accuracy"] > ours.scores["detector"]["accuracy"]


def test_a_result_with_a_yaml_graph_runs_again_where_the_file_is_gone(tmp_path: Path) -> None:
    file = tmp_path / "paper.yaml"
    file.write_text((EXAMPLES / "sensor_failure.yaml").read_text())
    experiment = write_drive(tmp_path, graph="./paper.yaml")
    assert "ok (3 lanes, 6 joint states)" in done("validate", experiment).stdout
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    file.unlink()
    again = tmp_path / "out" / "experiment.yaml"
    done("run", again, "--no-figures", "--out", tmp_path / "again")
    one, other = read_result(tmp_path / "out"), read_result(tmp_path / "again")
    np.testing.assert_array_equal(one.marginals["Lane"], other.marginals["Lane"])
    assert one.values["SensorState"] == ("OK", "BAD")


def test_every_table_function_makes_the_table_that_it_says(tmp_path: Path) -> None:
    module = load(
        tmp_path,
        """
        nodes: {Lane: n_lanes, S: [A, B], Left: [no_, yes_], D: n_lanes, E: 3}
        hidden: [Lane, S, Left]
        observed: [[D, S], E]
        edges:
          within: [Lane -> Left, Lane -> D, S -> D, S -> E, Left -> E]
          across: [Lane -> Lane, S -> S, S -> Lane]
        parameters:
          p: {kind: probability, default: 0.3, per_lane: true}
          q: {kind: probability, default: 0.2}
        tables:
          Lane:
            first: {rows: {values: [0.5, q, rest]}}
            next:
              stack:
                over: S before
                A: {identity: {of: Lane before}}
                B: {normal: {around: Lane before, sigma: 0.5}}
          S:
            first: uniform
            next: {binary: {of: S before, ok: 1 - q, bad: 0.9}}
          Left: {rows: {of: Lane, values: [[0, 1], [1, 0], [1, 0]]}}
          D:
            stack:
              over: S
              A: {normal: {around: Lane, sigma: 0.4, shift: -1, how: integral}}
              else: {stack: {over: Lane, else: {rows: {values: [p, q, rest]}}}}
          E: {rows: {of: [S, Left], values: [[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [q, q, rest]]]}}
        """,
    )
    given = {"p": [0.1, 0.2, 0.3], "q": 0.25}
    np.testing.assert_allclose(table(module, ("Lane", 0), **given).values, [0.5, 0.25, 0.25])
    lane = table(module, ("Lane", 1), **given)
    assert lane.parents == (("S", 0), ("Lane", 0))
    np.testing.assert_array_equal(lane.values[0], np.eye(3))
    row = np.exp(-0.5 * (np.arange(3) / 0.5) ** 2)
    np.testing.assert_allclose(lane.values[1, 0], row / row.sum())
    sensor = table(module, ("S", 1), **given)
    np.testing.assert_allclose(sensor.values, [[0.75, 0.25], [0.1, 0.9]])
    detector = table(module, ("D", 1), **given)
    assert detector.parents == (("S", 1), ("Lane", 1))
    np.testing.assert_allclose(
        detector.values[1], [[0.1, 0.25, 0.65], [0.2, 0.25, 0.55], [0.3, 0.25, 0.45]]
    )
    # Shifted a lane to the left: lane 2's output is lane 1's.
    assert detector.values[0].argmax(axis=1).tolist() == [0, 0, 1]
    leaf = table(module, ("E", 1), **given)
    assert leaf.parents == (("S", 1), ("Left", 1))
    np.testing.assert_allclose(leaf.values[1, 1], [0.25, 0.25, 0.5])
    parameters = resolve_parameters(module.PARAMETERS, given, 3)
    network = compiled_graph(module, 3, parameters)
    evidence = draw_evidence(network, 2, np.random.default_rng(0))
    for method in METHODS:
        right = brute_force(module.tables(3, parameters), module.HIDDEN, evidence, method)
        assert_filters_agree(network, evidence, {method: right})


def test_an_input_node_needs_no_table_and_selects_the_transition(tmp_path: Path) -> None:
    module = load(
        tmp_path,
        """
        nodes: {Lane: 2, InputSpeed: [slow, fast], Seen: 2}
        hidden: [Lane]
        observed: [Seen]
        inputs: [InputSpeed]
        edges: {within: [InputSpeed -> Lane, Lane -> Seen], across: [Lane -> Lane]}
        tables:
          Lane:
            first: {stack: {over: InputSpeed, else: uniform}}
            next:
              stack:
                over: InputSpeed
                slow: {identity: {of: Lane before}}
                fast: {binary: {of: Lane before, ok: 0.6, bad: 0.7}}
          Seen: {identity: {of: Lane}}
        """,
    )
    network = compiled_graph(module, 2, {})
    assert network.inputs == ("InputSpeed",)
    np.testing.assert_allclose(network.transition, [np.eye(2), [[0.6, 0.4], [0.3, 0.7]]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1, 2]", "g.yaml: needs keys and values"),
        ("a: [", "is not YAML"),
        (changed(nods={}), "g.yaml: unknown key 'nods' (did you mean 'nodes'?)"),
        (changed(hidden=None), "g.yaml: hidden: is missing"),
        (changed(hidden=["Lan"]), "hidden: no node 'Lan' (did you mean 'Lane'?)"),
        (changed(hidden="Lane"), "hidden: needs a list of nodes, got 'Lane'"),
        (changed(unused=5), "unused: needs a list of nodes, got 5"),
        (changed(observed=[["Seen", "Sen"]]), "observed: no node 'Sen' (did you mean 'Seen'?)"),
        (changed(nodes__Lane="lanes"), "nodes.Lane: 'lanes' is not n_lanes, a number of values"),
        (changed(nodes__Lane=True), "nodes.Lane: True is not n_lanes"),
        (changed(tables__Seen=None), "tables.Seen: is missing"),
        (changed(tables__Sen="uniform"), "tables: unknown key 'Sen' (did you mean 'Seen'?)"),
        (changed(edges__wthin=[]), "edges: unknown key 'wthin' (did you mean 'within'?)"),
        (changed(edges__within=["Lane > Seen"]), "'Lane > Seen' is not an edge, e.g."),
        (changed(edges__within=["Lane -> Sen"]), "no node 'Sen' (did you mean 'Seen'?)"),
        (changed(parameters={"s": {"default": 1}}), "parameters.s: kind: is missing"),
        (changed(parameters={"s": {"kind": "sigm"}}), "s: kind: 'sigm' is not one of sigma, prob"),
        (changed(parameters={"s": {"kind": "sigma"}}), "parameters.s: default: is missing"),
        (
            changed(parameters={"s": {"kind": "probability", "default": 2}}),
            "parameters.s.default: 2 is not a probability (0 to 1)",
        ),
        (
            changed(parameters={"s": {"kind": "sigma", "default": 1, "bounds": 3}}),
            "parameters.s: bounds: needs a list (got 3)",
        ),
        (
            changed(parameters={"s": {"kind": "sigma", "default": 1, "bound": [0, 3]}}),
            "parameters.s: unknown key 'bound' (did you mean 'bounds'?)",
        ),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_together_is_refused_by_its_name_and_key(
    tmp_path: Path, text: str, said: str
) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    assert said in str(caught.value)
    assert str(caught.value).startswith("graph: ")


def test_all_that_is_wrong_with_a_file_is_said_at_once(tmp_path: Path) -> None:
    def said(text: str) -> list[str]:
        with pytest.raises(InputError) as caught:
            load(tmp_path, text).build(3, {"sigma": 0.5})
        return [line.removeprefix("graph: g.yaml: ") for line in caught.value.lines]

    parameters = {"s": {"kind": "sigm", "low": 0}, "p": {"kind": "probability", "default": 2}}
    assert said(changed(nods=3, hidden=None, parameters=parameters)) == [
        "unknown key 'nods' (did you mean 'nodes'?)",
        "hidden: is missing",
        "parameters.p.default: 2 is not a probability (0 to 1)",
        "parameters.s: unknown key 'low' (did you mean 'lowest'?)",
        "parameters.s: kind: 'sigm' is not one of sigma, probability, positive, non_negative,"
        " integer, choice (did you mean 'sigma'?)",
        "parameters.s: default: is missing",
    ]
    assert said(changed(hidden=["Lan"], observed=["Sen", "Lane", "See"], tables__Sen=3)) == [
        "tables: unknown key 'Sen' (did you mean 'Seen'?)",
        "observed: no node 'Sen' (did you mean 'Seen'?)",
        "observed: no node 'See' (did you mean 'Seen'?)",
        "hidden: no node 'Lan' (did you mean 'Lane'?)",
    ]
    assert said(changed(tables={"Lane": "uniform", "Seen": "unifrm"})) == [
        "tables.Lane: has a parent in the slice before, so it needs first and next",
        "tables.Seen: unknown table function 'unifrm' (did you mean 'uniform'?)",
    ]


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ("unifrm", "tables.Seen: unknown table function 'unifrm' (did you mean 'uniform'?)"),
        ({"norml": {}}, "unknown table function 'norml' (did you mean 'normal'?)"),
        ([1, 2], "unknown table function '[1, 2]'"),
        ("uniform", "tables.Seen: the table uses no parent, its edges come from Lane"),
        ({"identity": {"of": "Lan"}}, "'Lan' is no parent by the edges (did you mean 'Lane'?)"),
        ({"identity": {"of": "Seen"}}, "tables.Seen: 'Seen' is no parent by the edges"),
        ({"identity": {}}, "tables.Seen: identity needs of; of is missing"),
        ({"identity": {"of": "Lane", "x": 1}}, "tables.Seen: identity: unknown key 'x'"),
        ({"normal": {"around": "Lane", "sigma": "sigm"}}, "no parameter 'sigm' (did you mean"),
        ({"normal": {"around": "Lane", "sigma": "2 * sigma"}}, "'2 * sigma' is no number and no"),
        ({"normal": {"around": "Lane", "sigma": -1}}, "sigma -1.0 must be greater than 0"),
        ({"binary": {"of": "Lane", "ok": 1, "bad": 1}}, "binary is for nodes with 2 values, not 3"),
        ({"rows": {"of": "Lane", "values": [[1, 0, 0]]}}, "rows needs 3 x 3 numbers, got [[1, 0"),
        ({"rows": {"of": "Lane", "values": [[1, 1, 0]] * 3}}, "the rows of the table must sum"),
        ({"stack": {"over": "Lane", "1": "uniform"}}, "no table for Lane 2, and no else"),
        ({"stack": {"over": "Lane", "4": "uniform"}}, "stack: Lane has no value '4' (known: 1, 2"),
        (
            {"stack": {"over": "Lane", "else": {"identity": {"of": "Lane"}}}},
            "tables.Seen.1: 'Lane' is no parent by the edges",
        ),
        ({"first": "uniform"}, "tables.Seen: needs first and next, has first"),
    ],
)  # fmt: skip
def test_a_table_that_does_not_fit_is_refused_naming_node_and_parent(
    tmp_path: Path, seen: Any, said: str
) -> None:
    module = load(tmp_path, changed(tables__Seen=seen))
    with pytest.raises(InputError) as caught:
        module.build(3, resolve_parameters(module.PARAMETERS, {}, 3))
    assert said in str(caught.value)


def test_a_node_with_a_parent_in_the_slice_before_needs_first_and_next(tmp_path: Path) -> None:
    module = load(tmp_path, changed(tables__Lane="uniform"))
    with pytest.raises(InputError, match=r"tables.Lane: has a parent in the slice before"):
        module.build(2, {"sigma": 0.5})


def test_what_is_wrong_is_said_by_validate_with_the_experiments_name(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(changed(tables__Seen="unifrm"))
    experiment = write_drive(tmp_path, 20, graph="./g.yaml", evidence="counting")
    said = refused("validate", experiment)
    assert "the graph observes Seen, the evidence rule gives only" in said
    text = (EXAMPLES / "sensor_failure.yaml").read_text()
    (tmp_path / "g.yaml").write_text(text.replace("BAD: uniform", "BAD: unifrm"))
    said = refused("validate", experiment)
    assert "experiment.yaml: graph ./g.yaml: tables.DetectorOutput.BAD: unknown table" in said
    (tmp_path / "g.yaml").write_text(text.replace("Lane -> Lane,", "Lane -> Lane, WOR -> Lane,"))
    assert "the table uses Lane before, its edges come from" in refused("validate", experiment)
    (tmp_path / "g.yaml").write_text(
        text.replace("SensorState -> WOR]", "SensorState -> WOR, WOR -> SensorState]")
    )
    assert "SensorState" in refused("validate", experiment)
    assert "no file" in refused("validate", experiment, "--set", "graph=./nothing.yaml")


def test_a_new_number_of_levels_compiles_the_network_anew() -> None:
    from egolane_pgm.model import with_parameters

    experiment = load_experiment(EXAMPLES / "yaml_graph.yaml").model_copy(
        update={"graph": "wor_levels", "evidence": "counting_levels"}
    )
    model = prepare_model(experiment)
    other = with_parameters(model, {**model.parameters, "wor_levels": 5})
    assert [m.compiled.groups[1].sizes for m in (model, other)] == [(3,), (5,)]


def test_a_cycle_in_a_graph_in_yaml_is_refused_naming_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, X: 2, Y: 2, DetectorOutput: n_lanes}\nhidden: [Lane, X, Y]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput, X -> Y, Y -> X], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: uniform, next: {identity: {of: Lane before}}}\n"
        "  X: {identity: {of: Y}}\n  Y: {identity: {of: X}}\n"
        "  DetectorOutput: {identity: {of: Lane}}\n"
    )
    said = refused("validate", write_drive(tmp_path, 20, graph="./g.yaml"))
    cycle = "graph ./g.yaml: the edges within a slice form a cycle: X -> Y -> X"
    assert f"experiment.yaml: {cycle}" in said


def test_a_table_function_that_does_not_exist_is_refused_with_a_suggestion(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, DetectorOutput: n_lanes}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: uniform, next: {norml: {around: Lane before, sigma: 0.4}}}\n"
        "  DetectorOutput: {identity: {of: Lane}}\n"
    )
    said = refused("run", write_drive(tmp_path, 20, graph="./g.yaml"), "--out", tmp_path / "out")
    assert "graph ./g.yaml: tables.Lane.next: unknown table function 'norml'" in said
    assert "(did you mean 'normal'?)" in said
