"""The oracle against brute force: it must not need the code that it is there to check."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, quiet, within
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import (
    METHODS,
    assert_same_beliefs,
    brute_force,
    draw_evidence,
    draw_graph,
    draw_parameters,
    graph,
)
from tests.reference.oracle import oracle_assumed_density, oracle_filter, unroll

ORACLES = {"exact": oracle_filter, "assumed_density": oracle_assumed_density}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(200, 206))
def test_the_oracle_agrees_with_brute_force_on_random_networks(method: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    network = declare(drawn.tables, drawn.observed)
    evidence = draw_evidence(drawn.compiled(), 2, rng)
    ours = ORACLES[method](network, drawn.hidden, drawn.observed, evidence, drawn.inputs)
    assert_same_beliefs(ours, brute_force(drawn.tables, drawn.hidden, evidence, method), 1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_the_oracle_agrees_with_brute_force_on_three_frames_of_the_paper(method: str) -> None:
    rng = np.random.default_rng(0)
    module = graph("sensor_failure")
    parameters = draw_parameters(module.PARAMETERS, 2, rng)
    network = module.build(2, parameters)
    evidence = Evidence({"DetectorOutput": rng.random((3, 2)), "WOR": rng.random((3, 2))})
    ours = ORACLES[method](network, module.HIDDEN, module.OBSERVED, evidence)
    right = brute_force(module.tables(2, parameters), module.HIDDEN, evidence, method)
    assert_same_beliefs(ours, right, 1e-12)


def test_virtual_evidence_nodes_agree_with_pgmpy_s_own_virtual_evidence() -> None:
    """The two ways to give pgmpy soft evidence: our `_ve` children, and its own argument."""
    rng = np.random.default_rng(1)
    module = graph("sensor_failure")
    network = module.build(3, draw_parameters(module.PARAMETERS, 3, rng))
    evidence = Evidence({"DetectorOutput": rng.random((3, 3)), "WOR": rng.random((3, 2))})
    ours = oracle_filter(network, module.HIDDEN, module.OBSERVED, evidence)
    silent = Evidence({key: np.ones_like(v) for key, v in evidence.likelihoods.items()})
    with quiet():
        from pgmpy.factors.discrete import TabularCPD
        from pgmpy.inference import VariableElimination

        for t in range(3):
            virtual = [
                TabularCPD(f"{key}@{s}", values.shape[1], (values[s] / values[s].sum())[:, None])
                for key, values in evidence.likelihoods.items()
                for s in range(t + 1)
            ]
            for name in module.HIDDEN:
                inference = VariableElimination(unroll(network, module.OBSERVED, silent))
                factor = inference.query(
                    [f"{name}@{t}"], virtual_evidence=virtual, show_progress=False
                )
                np.testing.assert_allclose(factor.values, ours.marginals[name][t], atol=1e-12)


def test_the_unrolled_network_holds_each_likelihood_over_its_maximum() -> None:
    module = graph("sensor_failure")
    network = module.build(3, draw_parameters(module.PARAMETERS, 3, np.random.default_rng(2)))
    detector = np.array([[0.2, 0.8, 0.4], [0.0, 0.0, 0.0]])
    evidence = Evidence({"DetectorOutput": detector, "WOR": np.ones((2, 2))})
    model = unroll(network, module.OBSERVED, evidence)
    first = model.get_cpds("DetectorOutput_ve@0")
    np.testing.assert_allclose(first.values, [[0.75, 0, 0.5], [0.25, 1, 0.5]])
    np.testing.assert_allclose(model.get_cpds("DetectorOutput_ve@1").values[1], [0, 0, 0])
    edges = {tuple(edge) for edge in model.edges()}
    assert ("Lane@0", "Lane@1") in edges
    assert ("SensorState@1", "DetectorOutput@1") in edges
    assert not any(start.endswith("@1") and end.endswith("@0") for start, end in edges)


def test_the_oracle_uses_neither_compile_nor_the_filters(monkeypatch: pytest.MonkeyPatch) -> None:
    module = graph("lane_only")
    network = module.build(2, draw_parameters(module.PARAMETERS, 2, np.random.default_rng(3)))
    evidence = Evidence({"DetectorOutput": np.array([[0.3, 0.7], [0.6, 0.4]])})
    for name in ("compile", "filtering", "kernels", "layout"):
        monkeypatch.setitem(sys.modules, f"egolane_pgm.inference.{name}", None)
    monkeypatch.delitem(sys.modules, "tests.reference.oracle")
    import tests.reference.oracle as fresh

    beliefs = fresh.oracle_filter(network, module.HIDDEN, module.OBSERVED, evidence)
    np.testing.assert_allclose(beliefs.lane.sum(axis=1), 1)


def test_log_evidence_counts_the_likelihoods_as_given() -> None:
    tables = [
        *prior("Lane", [0.25, 0.75]),
        *dynamics("Lane", [previous("Lane")], np.eye(2)),
        *within("D", ["Lane"], np.eye(2)),
    ]
    evidence = Evidence({"D": np.array([[4.0, 8.0], [2.0, 0.0]])})
    network = declare(tables, ["D"])
    beliefs = oracle_filter(network, ["Lane"], ["D"], evidence)
    # .25 * 4 + .75 * 8 = 7; then lane 1 has 1/7 and likelihood 2.
    np.testing.assert_allclose(beliefs.log_evidence, np.log([7, 2 / 7]))
    np.testing.assert_allclose(beliefs.lane, [[1 / 7, 6 / 7], [1, 0]], atol=1e-15)


@pytest.mark.parametrize("size", [1e-100, 1e-200])
def test_a_sequence_too_improbable_for_pgmpy_is_refused_not_taken_for_impossible(
    size: float,
) -> None:
    tables = [
        *prior("Lane", [0.5, 0.5]),
        *dynamics("Lane", [previous("Lane")], np.eye(2)),
        *within("D", ["Lane"], np.array([[1.0, 0.0], [1.0, 0.0]])),
    ]
    evidence = Evidence({"D": np.array([[size, 1.0]] * 4)})
    with pytest.raises(InputError, match="too improbable for the oracle"):
        oracle_filter(declare(tables, ["D"]), ["Lane"], ["D"], evidence)
