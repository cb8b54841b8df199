"""Special cases in which one graph equals another, and what distinguishes it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameters, resolve_parameters
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
    known = {spec.name for spec in module.parameters}
    own = {k: v for k, v in given.items() if k in known}
    parameters = resolve_parameters(module.parameters, own, n_lanes)
    return compiled_graph(module, n_lanes, parameters)


@pytest.mark.parametrize("n_lanes", [1, 3, 4])
@pytest.mark.parametrize(
    ("name", "base", "given"),
    [
        ("sensor_dynamics", "sensor_failure", {"sigma1_bad": "sigma1"}),
        ("wor_on_lane", "sensor_failure", {}),
        ("autoregressive", "sensor_failure", {"p_repeat_ok": 0.0, "p_repeat_bad": 0.0}),
    ],
)
def test_a_variant_with_these_parameters_is_the_graph_that_it_extends(
    name: str, base: str, given: dict[str, Any], n_lanes: int
) -> None:
    rng = np.random.default_rng(n_lanes)
    parameters = draw_parameters(graph(base).parameters, n_lanes, rng)
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
