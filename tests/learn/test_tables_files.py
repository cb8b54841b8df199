"""Learned tables as a graph in YAML, and experiments of which no table can be learned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm.experiment import load_experiment, resolved
from egolane_pgm.graphs.cpds import declare
from egolane_pgm.inference.compile import compile_network
from egolane_pgm.learn import fit, n_learned, with_found
from egolane_pgm.learn.graph_file import graph_yaml
from egolane_pgm.learn.tables import found_tables
from egolane_pgm.loading import load_recording
from egolane_pgm.model import Drive, Model, prepare_model
from egolane_pgm.plugins import load_plugin
from egolane_pgm.types import InputError
from tests.conformance.networks import draw_graph, graph_names
from tests.conftest import needs_compiler
from tests.kits.drives import done, refused, write_drive

DISCRETE = [name for name in graph_names() if name != "position_in_lane"]

#: Short drives do not come to each lane.
pytestmark = pytest.mark.filterwarnings("ignore:.*no frame to learn from has lane:UserWarning")


@needs_compiler
@pytest.mark.parametrize("name", DISCRETE)
def test_every_discrete_graph_can_be_learned_and_written(name: str, tmp_path: Path) -> None:
    """The file compiles to the arrays that were learned, with the same nodes."""
    rule = "counting_levels" if name == "wor_levels" else "counting"
    experiment = load_experiment(write_drive(tmp_path, 200, graph=name, evidence=rule))
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    found = fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))
    assert n_learned(model, experiment) > 0
    learned = with_found(model, found, experiment)
    content = graph_yaml(model, found_tables(model, found, experiment), "learned")
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    module = load_plugin("graphs", "./g.yaml", tmp_path, "graph")
    assert (module.HIDDEN, module.OBSERVED) == (model.graph.HIDDEN, model.graph.OBSERVED)
    for optional, default in (("VALUES", {}), ("UNUSED", ())):
        assert getattr(module, optional) == getattr(model.graph, optional, default)
    read = compile_network(module.build(3, {}), module.HIDDEN, module.OBSERVED, module.INPUTS)
    np.testing.assert_allclose(read.prior, learned.compiled.prior, rtol=1e-9, atol=0)
    np.testing.assert_allclose(read.transition, learned.compiled.transition, rtol=1e-9, atol=0)
    for mine, right in zip(read.groups, learned.compiled.groups, strict=True):
        assert mine.observed == right.observed
        np.testing.assert_allclose(mine.emission, right.emission, rtol=1e-9, atol=0)


@pytest.mark.parametrize("seed", range(8))
def test_random_graphs_come_back_from_their_file(seed: int, tmp_path: Path) -> None:
    """Inputs, functions and joint evidence too; a graph of one's own may have all of them."""
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    network = declare(drawn.tables, drawn.observed)
    compiled = compile_network(network, drawn.hidden, drawn.observed, drawn.inputs)
    own = tmp_path / "own.py"
    own.write_text("HIDDEN, OBSERVED, INPUTS, PARAMETERS = (), (), (), ()\ndef build(n, p): ...\n")
    module = load_plugin("graphs", "./own.py", tmp_path, "graph")
    module.HIDDEN, module.OBSERVED = drawn.hidden, drawn.observed  # type: ignore[attr-defined]
    module.INPUTS = drawn.inputs  # type: ignore[attr-defined]
    model = Model(module, module, {}, compiled, 3)
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(graph_yaml(model, drawn.tables, "")))
    read = load_plugin("graphs", "./g.yaml", tmp_path, "graph")
    found = compile_network(read.build(3, {}), read.HIDDEN, read.OBSERVED, read.INPUTS)
    np.testing.assert_allclose(found.transition, compiled.transition, rtol=1e-9)
    np.testing.assert_allclose(found.prior, compiled.prior, rtol=1e-9)
    for mine, right in zip(found.groups, compiled.groups, strict=True):
        np.testing.assert_allclose(mine.emission, right.emission, rtol=1e-9)


# --- what cannot be learned ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("learning", "said"),
    [
        ({"tables": []}, "learning.tables: names no table; leave it out to learn all of"),
        ({"tables": ["Lan"]}, "learning.tables: 'Lan' has no table to learn (did you mean 'Lane'?"),
        ({"strenth": 3}, "learning: unknown key 'strenth' (did you mean 'strength'?)"),
        ({"strength": 0}, "learning.strength: input should be greater than 0 (got 0)"),
        ({"strength": float("inf")}, "learning.strength: input should be a finite number"),
        ({"iterations": 0}, "learning.iterations: input should be greater than or equal to 1"),
        ({"labels": "perhaps"}, "learning.labels: input should be a valid boolean"),
    ],
)
def test_a_setting_that_does_not_fit_is_named(
    tmp_path: Path, learning: dict[str, object], said: str
) -> None:
    assert said in refused("learn", write_drive(tmp_path, 30, learning=learning))


def test_a_graph_without_a_table_to_learn_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, DetectorOutput: n_lanes}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: {rows: {values: [1, 0, 0]}},"
        " next: {identity: {of: Lane before}}}\n  DetectorOutput: {identity: {of: Lane}}\n"
    )
    said = refused("learn", write_drive(tmp_path, 30, graph="./g.yaml"))
    assert "evidence rule counting cannot be learned, nor can the graph ./g.yaml" in said
    assert "egolane tune" in said
    said = refused("compare", tmp_path / "experiment.yaml", "--set", "fit=learn")
    assert "nor can the graph ./g.yaml" in said


def test_evidence_read_by_jeffreys_rule_cannot_be_learned_from(tmp_path: Path) -> None:
    said = refused("learn", write_drive(tmp_path, 30, evidence_reading="jeffrey"))
    assert "Jeffrey's rule" in said
    assert "evidence_reading soft or hard" in said


def test_how_tables_are_learned_is_no_part_of_what_is_run(tmp_path: Path) -> None:
    plain = load_experiment(write_drive(tmp_path, 30))
    learning = load_experiment(write_drive(tmp_path, 30, learning={"labels": False}))
    assert resolved(plain, {}) == resolved(learning, {})


def test_what_every_block_has_to_say_is_said_once(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60)
    said = done("learn", path, "--out", tmp_path / "a.yaml").stderr.splitlines()
    about = [line for line in said if "no frame to learn from has lane" in line]
    assert about
    assert len(set(about)) == len(about)
    assert all(line.startswith("warning: ") for line in about)


def test_the_experiment_itself_is_not_written_over(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 30)
    before = path.read_text()
    assert "is the experiment itself" in refused("learn", path, "--out", path)
    assert path.read_text() == before


def test_a_file_that_the_experiment_reads_is_not_written_over(tmp_path: Path) -> None:
    """The graph that is learned would be the one that it was learned from."""
    graph = tmp_path / "out.graph.yaml"
    graph.write_text(
        "nodes: {Lane: n_lanes, DetectorOutput: n_lanes}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: uniform, next: {rows: {of: [Lane before],"
        " values: [[.8, .1, .1], [.1, .8, .1], [.1, .1, .8]]}}}\n"
        "  DetectorOutput: {identity: {of: Lane}}\n"
    )
    before = graph.read_text()
    path = write_drive(tmp_path, 30, graph="./out.graph.yaml")
    said = refused("learn", path, "--out", tmp_path / "out.yaml")
    assert said.endswith(f"{graph}: is read by {path}; name another with --out")
    assert refused("learn", path, "--out", tmp_path / "lines.csv").endswith("with --out")
    assert graph.read_text() == before
    done("learn", path, "--out", tmp_path / "other.yaml", "--blocks", "2")


def test_what_a_rule_learned_is_written_with_four_digits(tmp_path: Path) -> None:
    (tmp_path / "rule.py").write_text(
        "from egolane_pgm.evidence import counting\n"
        "from egolane_pgm.parameters import Parameter\n"
        "PARAMETERS = (*counting.PARAMETERS, Parameter(\n"
        "    'shares', 'non_negative', (0.0,) * 6, '', shape=lambda n: (n, 2)))\n"
        "PROVIDES, evidence, LEARNED = counting.PROVIDES, counting.evidence, ('shares',)\n"
        "def fit(log, lane, is_used, n_lanes, parameters):\n"
        "    return {'shares': (0.123456, 2.0, 1234.56, 1e-7, 0.0, 0.999949)}\n"
    )
    path = write_drive(tmp_path, 60, evidence="./rule.py")
    done("learn", path, "--out", tmp_path / "out.yaml", "--blocks", "2")
    content = yaml.safe_load((tmp_path / "out.yaml").read_text())
    assert content["parameters"]["shares"] == [[0.1235, 2.0], [1235.0, 1e-7], [0.0, 0.9999]]


@needs_compiler
def test_labels_that_the_graph_does_not_allow_are_left_out_and_counted(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 600, tuned_on="not_tuned", parameters={"sigma1": 1e-9})
    experiment = load_experiment(path)
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    with pytest.warns(UserWarning, match=r"frame\(s\) to learn from cannot be under graph sensor"):
        fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))


def test_labels_that_the_graph_never_allows_leave_nothing_to_learn(tmp_path: Path) -> None:
    """Lane 1 is all that the graph knows of, and the drive is labelled as one in lane 3."""
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, DetectorOutput: n_lanes}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: {rows: {values: [1, 0, 0]}},"
        " next: {identity: {of: Lane before}}}\n"
        "  DetectorOutput: {rows: {of: [Lane],"
        " values: [[.8, .1, .1], [.1, .8, .1], [.1, .1, .8]]}}\n"
    )
    experiment = load_experiment(write_drive(tmp_path, 60, graph="./g.yaml"))
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    n_frames = len(recorded.truth)
    truth = replace(recorded.truth, lane=np.full(n_frames, 3), is_crossing=np.zeros(n_frames, bool))
    with pytest.raises(InputError, match="none of the 60 frames to learn from can be under graph"):
        fit(Drive(experiment, model, replace(recorded, truth=truth)), np.arange(n_frames))


def test_learning_that_does_not_stand_still_says_so(tmp_path: Path) -> None:
    experiment = load_experiment(write_drive(tmp_path, 60, learning={"iterations": 1}))
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    with pytest.warns(UserWarning, match="stopped after 1 iterations"):
        fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))


def test_without_labels_no_number_is_fitted_to_them(tmp_path: Path) -> None:
    for labels in (True, False):
        experiment = load_experiment(write_drive(tmp_path, 30, learning={"labels": labels}))
        assert (n_learned(prepare_model(experiment), experiment) > 0) is labels
