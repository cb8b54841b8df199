"""Experiments whose plugins do not go together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.results import read_result
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


def graph_said(folder: Path, more: str, hidden: str = '("Lane", "X")') -> str:
    """What is said of a graph of one's own: the paper's Lane and detector, and `more`."""
    (folder / "g.py").write_text(GRAPH.format(more=more, hidden=hidden))
    said = refused("validate", write_drive(folder, 20, graph="./g.py"))
    assert refused("run", folder / "experiment.yaml", "--out", folder / "out") == said
    assert "experiment.yaml: graph" in said
    assert "./g.py" in said or "g.py" in said
    return said


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("Lane")], uniform(4, 2))',
            "X: its table has 4 rows for Lane, which has 3 values",
        ),
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("Y")], uniform(2, 2))',
            "X at t+1 has the parent Y at t, for which there is no table",
        ),
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("X")], uniform(2))',
            "P(X at t+1 | X at t): the table has 1 axes, needs 2",
        ),
    ],
)
def test_a_table_that_does_not_fit_its_parents_is_refused_naming_both(
    tmp_path: Path, more: str, said: str
) -> None:
    assert said in graph_said(tmp_path, more)


def test_a_cycle_in_a_slice_is_refused_naming_its_nodes(tmp_path: Path) -> None:
    two = '*within("X", ["Y"], np.eye(2)), *within("Y", ["X"], np.eye(2))'
    said = graph_said(tmp_path, two, '("Lane", "X", "Y")')
    assert "the edges within a slice form a cycle: X -> Y -> X" in said
    three = (
        '*within("X", ["Z"], np.eye(2)), *within("Y", ["X"], np.eye(2)),'
        ' *within("Z", ["Y"], np.eye(2))'
    )
    said = graph_said(tmp_path, three, '("Lane", "X", "Y", "Z")')
    assert "form a cycle: X -> Y -> Z -> X" in said
    said = graph_said(tmp_path, '*within("X", ["X"], np.eye(2))')
    assert "form a cycle: X -> X" in said


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


def test_nodes_that_are_neither_hidden_nor_observed_are_refused(tmp_path: Path) -> None:
    said = graph_said(tmp_path, '*within("X", ["Lane"], uniform(n, 2))', '("Lane",)')
    assert "X: neither hidden, observed, input nor virtual evidence" in said


def test_observed_nodes_and_evidence_that_miss_each_other_are_refused(tmp_path: Path) -> None:
    (tmp_path / "g.py").write_text(GRAPH.format(more="", hidden='("Lane",)').replace("WOR", "W"))
    said = refused("validate", write_drive(tmp_path, 20, graph="./g.py"))
    assert "the evidence rule gives WOR, which the graph does not observe" in said
    text = GRAPH.format(more='*within("GPS", ["Lane"], np.eye(n)),', hidden='("Lane",)')
    (tmp_path / "g.py").write_text(text.replace('("DetectorOutput",)', '("DetectorOutput", "GPS")'))
    said = refused("validate", tmp_path / "experiment.yaml")
    assert "the graph observes GPS, the evidence rule gives only DetectorOutput, WOR" in said


def test_a_joint_state_over_the_limit_is_refused_with_its_size_and_nodes(tmp_path: Path) -> None:
    more = '*prior("X", uniform(2000)), *dynamics("X", [previous("X")], np.eye(2000))'
    said = graph_said(tmp_path, more)
    assert "the joint state has 6000 values (Lane 3 x X 2000), more than 4096" in said
