"""The kernel for networks of one node that moves to values near its own, and others that move by
themselves: against the plain recursion, on networks with more in them than position in lane."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.kernels.banded import find_band
from egolane_pgm.types import Evidence, FloatArray
from tests.conformance.networks import METHODS, assert_same_beliefs, draw_evidence
from tests.reference import inference as reference

every_method = pytest.mark.parametrize("method", METHODS)

N_WIDE = 18


def near(half: int, floor: float) -> FloatArray:
    """(N_WIDE, N_WIDE): moves of up to `half` values, and `floor` for each other one."""
    rng = np.random.default_rng(half)
    away = np.abs(np.subtract.outer(np.arange(N_WIDE), np.arange(N_WIDE)))
    rows = np.where(away <= half, rng.uniform(0.5, 1.0, (N_WIDE, N_WIDE)), 0.0)
    rows /= rows.sum(axis=1, keepdims=True)
    return rows * (1 - N_WIDE * floor) + floor


@functools.cache
def network(n_others: int = 1, noise: float = 0.0) -> Compiled:
    """Wide, and others of two values each; Part is a function of Wide, Leaf sees Wide (wrongly by
    `noise`), and what is observed comes in four groups. An input selects the width of the band."""
    rng = np.random.default_rng(7)
    others = [f"Q{k}" for k in range(n_others)]
    sees = np.repeat(np.eye(3), N_WIDE // 3, axis=0) * (1 - 3 * noise) + noise
    tables = [
        *within("Speed", [], [0.5, 0.5]),
        *prior("Wide", rng.dirichlet(np.ones(N_WIDE), 2), ["Speed"]),
        *dynamics("Wide", ["Speed", previous("Wide")], np.stack([near(1, 0.0), near(4, 1e-3)])),
        *within("Part", ["Wide"], np.repeat(np.eye(2), N_WIDE // 2, axis=0)),
        *within("Leaf", ["Wide"], sees),
    ]
    for name in others:
        tables += prior(name, [0.3, 0.7])
        tables += dynamics(name, [previous(name)], rng.dirichlet(np.ones(2), 2))
    observed = ("Part", ("Q0", "Wide"), "Leaf", tuple(others) if n_others > 1 else "Q0")
    hidden = (others[0], "Wide", *others[1:], "Part")
    return compile(declare(tables, observed), hidden=hidden, observed=observed, inputs=("Speed",))


def random_evidence(compiled: Compiled, seed: int) -> Evidence:
    """Of any scale, some of it impossible."""
    rng = np.random.default_rng(seed)
    evidence = draw_evidence(compiled, 60, rng, zeros=0.2)
    for values in evidence.likelihoods.values():
        scale = 10.0 ** rng.choice([0, 0, -40, -70, 40], size=60)
        values *= scale.reshape(-1, *[1] * (values.ndim - 1))
    return evidence


@every_method
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("n_others", "noise"), [(1, 0.0), (2, 0.0), (1, 1e-4)])
def test_inputs_functions_and_several_evidences_agree_with_the_plain_recursion(
    n_others: int, noise: float, method: str, seed: int
) -> None:
    compiled = network(n_others, noise)
    assert find_band(compiled) is not None
    evidence = random_evidence(compiled, seed)
    right = reference.filter_beliefs(compiled, evidence, method)
    assert right.is_impossible.any()
    assert not right.is_impossible.all()
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right, 1e-9)


@every_method
def test_a_node_that_passes_and_an_observed_one_that_is_carried_may_stand_beside_the_wide_one(
    method: str,
) -> None:
    rng = np.random.default_rng(8)
    tables = [
        *prior("Wide", rng.dirichlet(np.ones(N_WIDE))),
        *dynamics("Wide", [previous("Wide")], near(2, 1e-3)),
        *within("Passes", [], [0.3, 0.7]),
        *prior("Kept", rng.dirichlet(np.ones(2), 2), ["Passes"]),
        *dynamics("Kept", ["Passes", previous("Kept")], rng.dirichlet(np.ones(2), (2, 2))),
        *within("Sees", ["Wide", "Passes"], rng.dirichlet(np.ones(3), (N_WIDE, 2))),
    ]
    observed = ["Kept", "Sees"]
    compiled = compile(declare(tables, observed), hidden=["Passes", "Wide"], observed=observed)
    assert set(compiled.state_nodes) == {"Wide", "Passes", "Kept"}
    assert find_band(compiled) is not None
    evidence = random_evidence(compiled, 0)
    right = reference.filter_beliefs(compiled, evidence, method)
    assert set(right.marginals) == {"Passes", "Wide"}
    assert_same_beliefs(filter_beliefs(compiled, evidence, method), right, 1e-9)


@every_method
def test_a_network_that_is_nearly_of_this_kind_is_not_taken_for_one(method: str) -> None:
    compiled = network()
    evidence = draw_evidence(compiled, 30, np.random.default_rng(1), zeros=0)
    mixed = compiled.transition.copy()
    # Q0, the slowest digit, hardly minds where Wide is: in its third value a little.
    after = mixed[:, 2, N_WIDE:] * 1e-5
    mixed[:, 2, N_WIDE:] -= after
    mixed[:, 2, :N_WIDE] += after
    leaning = replace(compiled, transition=mixed)
    assert find_band(leaning) is None
    right = reference.filter_beliefs(leaning, evidence, method)
    assert_same_beliefs(filter_beliefs(leaning, evidence, method), right, 1e-12)
    straight = filter_beliefs(compiled, evidence, method)
    assert np.abs(right.marginals["Wide"] - straight.marginals["Wide"]).max() > 1e-10


@every_method
def test_rounding_does_not_grow_over_frames_that_cannot_be(method: str) -> None:
    compiled = network()
    evidence = draw_evidence(compiled, 400, np.random.default_rng(4), zeros=0)
    evidence.likelihoods["Part"][1:] = 0
    beliefs = filter_beliefs(compiled, evidence, method)
    assert beliefs.is_impossible.tolist() == [False] + [True] * 399
    for name, rows in beliefs.marginals.items():
        np.testing.assert_allclose(rows.sum(axis=1), 1, rtol=0, atol=1e-13, err_msg=name)
