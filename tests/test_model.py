"""Experiments whose plugins do not go together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from egolane_pgm.results import read_result

from egolane_pgm.experiment import experiments_folder, load_experiment
from egolane_pgm.model import prepare_model
from egolane_pgm.parameters import Value
from tests.kits.drives import done, refused, write_drive

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
def test_a_graph_that_does_not_fit_is_refused_by_validate_and_run(
    tmp_path: Path, more: str, said: str
) -> None:
    (tmp_path / "g.py").write_text(GRAPH.format(more=more, hidden='("Lane", "X")'))
    path = write_drive(tmp_path, 20, graph="./g.py")
    found = refused("run", "--dry-run", path)
    assert refused("run", path, "--out", tmp_path / "out") == found
    assert said in found
    assert "experiment.yaml: graph" in found


def test_hidden_nodes_that_pass_and_a_detector_whose_errors_persist_run(tmp_path: Path) -> None:
    text = GRAPH.format(more='*within("X", ["Lane"], [[0.2, 0.8]] * n)', hidden='("Lane", "X")')
    keeps = (
        '*prior("DetectorOutput", np.eye(n), ["Lane"]),'
        ' *dynamics("DetectorOutput", ["Lane", previous("DetectorOutput")], uniform(n, n, n))'
    )
    (tmp_path / "g.py").write_text(
        text.replace('*within("DetectorOutput", ["Lane"], np.eye(n))', keeps)
    )
    write_drive(tmp_path, 20, graph="./g.py", filter="exact")
    done("run", tmp_path / "experiment.yaml", "--out", tmp_path / "out")
    marginals = read_result(tmp_path / "out").marginals
    assert set(marginals) == {"Lane", "X"}
    np.testing.assert_allclose(marginals["X"], [[0.2, 0.8]] * len(marginals["X"]), atol=1e-12)


def test_a_default_of_its_own_holds_where_the_whole_drive_is_read() -> None:
    def alpha(**overrides: object) -> Value:
        return prepare_model(
            load_experiment(experiments_folder() / "zero_label.yaml", overrides)
        ).parameters["alpha"]

    assert alpha(filter="smoothed") == 0.5 * alpha() > 0  # type: ignore[operator]
    assert alpha(filter="smoothed", **{"parameters.alpha": 0.035}) == alpha()
