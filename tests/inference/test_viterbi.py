"""The most probable path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.types import Evidence
from tests.conformance.networks import (
    any_compiled,
    draw_evidence,
    frames_to_enumerate,
    graph,
    graph_names,
    small_parameters,
    template,
)
from tests.kits.trajectories import enumerated_paths
from tests.reference import inference as reference


def check_against(compiled: Compiled, tables: list, evidence: Evidence, hidden: tuple) -> None:
    """The path is a part of the most probable one of all nodes that are in the joint state."""
    others = [name for name in compiled.state_nodes if name not in hidden]
    right = enumerated_paths(tables, (*hidden, *others), evidence)
    best = max(right.values())
    path = viterbi(compiled, evidence)
    states = [
        tuple(int(path.states[name].cat.codes.iloc[t]) for name in hidden)
        for t in range(len(evidence))
    ]
    ours = (p for found, p in right.items() if [v[: len(hidden)] for v in found] == states)
    np.testing.assert_allclose(max(ours), best, rtol=1e-9)
    np.testing.assert_allclose(path.log_probability, math.log(best), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", graph_names())
def test_no_trajectory_of_any_graph_is_more_probable(name: str) -> None:
    module = graph(name)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        tables = module.tables(2, small_parameters(name, 2, rng))
        compiled = with_tables(template(name, 2), tables)
        evidence = draw_evidence(compiled, frames_to_enumerate(compiled), rng)
        check_against(compiled, tables, evidence, module.hidden)


def test_the_path_is_as_probable_as_that_of_plain_numpy() -> None:
    """Where rounding decides between paths they may differ."""
    for seed in range(20):
        compiled = any_compiled(seed)
        evidence = draw_evidence(compiled, 200, np.random.default_rng(seed))
        path = viterbi(compiled, evidence)
        _, best = reference.best_path(compiled, evidence)
        assert path.log_probability == pytest.approx(best, abs=1e-9)
        if not set(compiled.state_nodes) <= set(compiled.hidden):
            continue
        sizes = [compiled.cardinality[name] for name in compiled.state_nodes]
        states = np.ravel_multi_index(
            [path.states[name].cat.codes for name in compiled.state_nodes], sizes
        )
        own = reference.path_probability(compiled, evidence, states)
        assert own == pytest.approx(best, abs=1e-9)


def test_of_equally_probable_paths_the_lowest_numbered_is_taken() -> None:
    compiled = template("sensor_failure", 3)
    says_nothing = Evidence({"DetectorOutput": np.ones((4, 3)), "WOR": np.ones((4, 2))})
    path = viterbi(compiled, says_nothing)
    # Lane 1 and lane 3 are mirror images; an outer lane is held more surely than the middle one.
    assert path.lane.tolist() == [1, 1, 1, 1]
    assert path.states["SensorState"].cat.codes.tolist() == [0, 0, 0, 0]


def test_long_drives_do_not_underflow_and_impossible_frames_are_ignored() -> None:
    compiled = template("sensor_failure", 4)
    n_frames = 10_000
    evidence = draw_evidence(compiled, n_frames, np.random.default_rng(0), zeros=0)
    for values in evidence.likelihoods.values():
        values *= 1e-100
    evidence.likelihoods["WOR"][17] = 0
    path = viterbi(compiled, evidence)
    assert np.flatnonzero(path.is_impossible).tolist() == [17]
    # Two likelihoods of about 1e-100 in each frame that counts.
    assert path.log_probability / (n_frames - 1) == pytest.approx(2 * math.log(1e-100), rel=0.04)
    assert set(np.unique(path.lane)) <= {1, 2, 3, 4}
    nothing = viterbi(compiled, evidence.take(slice(0, 0)))
    assert nothing.lane.tolist() == []
    assert nothing.log_probability == 0
