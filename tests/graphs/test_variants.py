"""Special cases in which one graph equals another, and what distinguishes it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence
from tests.conformance.networks import (
    METHODS,
    assert_same_beliefs,
    compiled_graph,
    draw_evidence,
    draw_parameters,
    graph,
)


def compiled(name: str, n_lanes: int, given: Parameters) -> Compiled:
    module = graph(name)
    known = {spec.name for spec in module.PARAMETERS}
    own = {k: v for k, v in given.items() if k in known}
    parameters = resolve_parameters(module.PARAMETERS, own, n_lanes)
    return compiled_graph(module, n_lanes, parameters)


@pytest.mark.parametrize("n_lanes", [1, 3, 4])
@pytest.mark.parametrize(
    ("name", "base", "given"),
    [
        ("sensor_dynamics", "sensor_failure", {"sigma1_bad": "sigma1"}),
        ("wor_on_lane", "sensor_failure", {}),
        ("autoregressive", "sensor_failure", {"p_repeat_ok": 0.0, "p_repeat_bad": 0.0}),
        ("autoregressive_wor", "autoregressive", {"p_repeat_wor": 0.0}),
        ("failure_duration", "sensor_failure", {"failure_phases": 1}),
    ],
)
def test_a_variant_with_these_parameters_is_the_graph_that_it_extends(
    name: str, base: str, given: dict[str, Any], n_lanes: int
) -> None:
    rng = np.random.default_rng(n_lanes)
    parameters = draw_parameters(graph(base).PARAMETERS, n_lanes, rng)
    own = {key: parameters.get(value, value) for key, value in given.items()}
    ours, right = (
        compiled(name, n_lanes, {**parameters, **own}),
        compiled(base, n_lanes, parameters),
    )
    assert_filtered_alike(ours, right, rng)


def assert_filtered_alike(ours: Compiled, right: Compiled, rng: np.random.Generator) -> None:
    """The filters believe the same of random evidence, in the nodes that both have. Assumed density
    is compared if no observed node is in the joint state."""
    evidence = draw_evidence(right, 30, rng)
    is_plain = set(ours.state_nodes) | set(right.state_nodes) <= {*ours.hidden, *right.hidden}
    for method in METHODS if is_plain else ["exact"]:
        found, expected = (filter_beliefs(each, evidence, method) for each in (ours, right))
        shared = {name: found.marginals[name] for name in expected.marginals}
        assert_same_beliefs(replace(found, marginals=shared), expected, 1e-12)


@pytest.mark.parametrize("n_lanes", [1, 2, 3, 4, 5])
def test_wor_on_edge_is_wor_on_lane_with_one_value_for_the_edges_and_one_between(
    n_lanes: int,
) -> None:
    rng = np.random.default_rng(n_lanes)
    parameters = draw_parameters(graph("wor_on_edge").PARAMETERS, n_lanes, rng)
    where = ["edge" if lane in (1, n_lanes) else "middle" for lane in range(1, n_lanes + 1)]
    per_lane = {p: [parameters[f"{p}_{w}"] for w in where] for p in ("p3", "p4")}
    known = {k: v for k, v in parameters.items() if not k.startswith(("p3", "p4"))}
    ours = compiled("wor_on_edge", n_lanes, parameters)
    right = compiled("wor_on_lane", n_lanes, {**known, **per_lane})
    assert_filtered_alike(ours, right, rng)


@pytest.mark.parametrize(("p2", "mean"), [(0.9, 10), (0.99, 100), (0.5, 3)])
def test_a_failure_of_three_phases_keeps_its_mean_duration(p2: float, mean: float) -> None:
    """A failure that begins lasts 1 / (1 - p2) frames on average, but a frame for each phase at
    least; its variance is that of three durations of a third each."""
    module = graph("failure_duration")
    parameters = resolve_parameters(module.PARAMETERS, {"p2": p2}, 3)
    moves = {t.node: t.values for t in module.tables(3, parameters)}["Phase", 1]
    phases, longer_than = np.array([1.0, 0.0, 0.0]), []
    for _ in range(5000):
        longer_than.append(phases.sum())
        phases = phases @ moves[1:, 1:]
    first = np.sum(longer_than)
    second = np.sum((2 * np.arange(5000) + 1) * longer_than)
    assert first == pytest.approx(mean)
    assert second - first**2 == pytest.approx(3 * (mean / 3) * (mean / 3 - 1), abs=1e-6)


def test_a_worn_sensor_has_its_own_sigma_and_leaves_for_each_other_state_alike() -> None:
    module = graph("three_sensor_states")
    given = {"p1": 0.8, "p_worn": 0.6, "p2": 0.9, "p3_worn": 0.3, "sigma2_worn": 2.0}
    parameters = resolve_parameters(module.PARAMETERS, given, 3)
    tables = {t.node: t.values for t in module.tables(3, parameters)}
    np.testing.assert_allclose(
        tables["SensorState", 1], [[0.8, 0.1, 0.1], [0.2, 0.6, 0.2], [0.05, 0.05, 0.9]]
    )
    np.testing.assert_allclose(tables["WOR", 1][1], [0.3, 0.7])
    row = np.exp(-0.5 * (np.arange(3) / 2.0) ** 2)
    np.testing.assert_allclose(tables["DetectorOutput", 1][1, 0], row / row.sum())


def test_a_sensor_that_is_biased_for_long_is_found_out() -> None:
    """The output jumps a lane to the right and stays there; lane changes are far rarer than that.
    The paper's graph gives in, this one keeps the lane and says RIGHT."""
    given = {"sigma1": 0.2, "sigma2": 0.25, "p1": 0.99, "p2": 0.9, "p_biased": 0.95}
    seen = 0.01 + 0.95 * np.eye(5)
    # Long enough before the jump for LEFT in the next lane, as good at first, to be ruled out.
    detector = np.repeat([seen[2], seen[3]], [300, 40], axis=0)
    wor = np.tile([0.9, 0.1], (340, 1))
    evidence = Evidence({"DetectorOutput": detector, "WOR": wor})
    biased = filter_beliefs(compiled("biased_sensor", 5, given), evidence, "exact")
    paper = filter_beliefs(compiled("sensor_failure", 5, given), evidence, "exact")
    assert paper.lane[-1].argmax() == 3
    assert biased.lane[-1].argmax() == 2
    assert biased.marginals["SensorState"][-1].argmax() == 2
    assert biased.marginals["SensorState"][30].argmax() == 0
