"""Models: plugins that fit together, and new parameters that are as good as a new model."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.contracts import Graph
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import (
    compile_model,
    make_evidence,
    matching_evidence_rule,
)
from egolane_pgm.parameters import Value
from egolane_pgm.plugins import load_plugin, plugin_names
from egolane_pgm.types import InputError
from tests.kits.drives import run, short_drive, simulated, write_drive

EXAMPLES = Path(__file__).parents[1] / "examples"

GRAPH = """
import numpy as np
from egolane_pgm.graphs.cpds import *
HIDDEN, OBSERVED, UNUSED = {hidden}, ("DetectorOutput",), ("WOR",)
def build(n, parameters):
    return declare([
        *prior("Lane", uniform(n)), *dynamics("Lane", [previous("Lane")], uniform(n, n)),
        *within("DetectorOutput", ["Lane"], np.eye(n)),
        {more}
    ], OBSERVED)
"""


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("Lane")], uniform(4, 2))',
            "X: its table has 4 rows for Lane, which has 3 values",
        ),
        (
            '*within("X", ["Y"], np.eye(2)), *within("Y", ["X"], np.eye(2))',
            "the edges within a slice form a cycle: X -> Y -> X",
        ),
        (
            '*within("X", ["Lane"], uniform(n, 2)), *within("Y", ["Lane"], uniform(n, 2))',
            "Y: neither hidden, observed, input nor virtual evidence",
        ),
        (
            '*prior("X", uniform(2000)), *dynamics("X", [previous("X")], np.eye(2000))',
            "the joint state has 6000 values (Lane 3 x X 2000), more than 4096",
        ),
    ],
)
def test_a_graph_that_does_not_fit_is_refused(tmp_path: Path, more: str, said: str) -> None:
    (tmp_path / "g.py").write_text(GRAPH.format(more=more, hidden='("Lane", "X")'))
    with pytest.raises(InputError) as info:
        compile_model(load_experiment(write_drive(tmp_path, 20, graph="./g.py")))
    assert said in str(info.value)
    assert "experiment.yaml: graph" in str(info.value)


def test_hidden_nodes_that_pass_and_a_detector_whose_errors_persist_run(tmp_path: Path) -> None:
    text = GRAPH.format(more='*within("X", ["Lane"], [[0.2, 0.8]] * n)', hidden='("Lane", "X")')
    keeps = (
        '*prior("DetectorOutput", np.eye(n), ["Lane"]),'
        ' *dynamics("DetectorOutput", ["Lane", previous("DetectorOutput")], uniform(n, n, n))'
    )
    (tmp_path / "g.py").write_text(
        text.replace('*within("DetectorOutput", ["Lane"], np.eye(n))', keeps)
    )
    found = run(write_drive(tmp_path, 20, graph="./g.py", filter="exact"))
    assert set(found.run["values"]) == {"Lane", "X"}
    np.testing.assert_allclose(found.node("X"), [[0.2, 0.8]] * len(found), atol=1e-12)


def test_a_default_of_its_own_holds_where_the_whole_drive_is_read() -> None:
    def alpha(**overrides: object) -> Value:
        return compile_model(load_experiment("zero_label", overrides)).parameters["alpha"]

    assert alpha(filter="smoothed") == 0.5 * alpha() > 0  # type: ignore[operator]
    assert alpha(filter="smoothed", **{"parameters.alpha": 0.035}) == alpha()


def test_a_model_is_pickled_with_its_plugins() -> None:
    model = compile_model(load_experiment(EXAMPLES / "own_files.yaml"))
    again = pickle.loads(pickle.dumps(model))
    log = short_drive().log
    for node, values in make_evidence(model, log)[0].likelihoods.items():
        other = make_evidence(again, log)[0].likelihoods[node]
        np.testing.assert_array_equal(other, values)


def test_every_graph_gets_an_evidence_rule_that_fits_it() -> None:
    found = {}
    for name in plugin_names(Graph):
        graph = load_plugin(Graph, name, "x")
        rule = matching_evidence_rule(graph, 3, "counting", "x")
        compile_model(load_experiment(simulated(graph=name, evidence=rule), n_lanes=3))
        found[name] = rule
    assert found["sensor_failure"] == "counting"
    assert found["position_in_lane"] == "line_geometry"
