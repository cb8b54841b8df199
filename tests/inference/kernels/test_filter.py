"""The compiled recursion and the compiled likelihood, for any size and for sizes that are
constants, against plain NumPy, with awkward likelihoods."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference import filtering
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import METHODS, filter_beliefs, state_likelihood
from egolane_pgm.types import Beliefs, Evidence
from tests.conformance.networks import assert_same_beliefs
from tests.reference import inference as reference

#: Without the compiler everything is thousands of times slower, and one size is as good as ten.
IS_COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"

#: Persistent nodes' sizes, groups' columns. Few, because each is compiled.
SIZES = [((4, 2), (4, 2)), ((3, 2), (3, 2)), ((4,), (4,)), ((1,), (1,)), ((2, 3), (5, 1, 2))]
SIZES = SIZES if IS_COMPILED else SIZES[:1]

every_method = pytest.mark.parametrize("method", METHODS)


@pytest.fixture(params=["fixed sizes", "any size"], autouse=True)
def fixed_sizes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test runs through both, however short its sequences are."""
    least = 1 if request.param == "fixed sizes" else 10**9
    monkeypatch.setattr(filtering, "MIN_FIXED_FRAMES", least)


def random_rows(rng: np.random.Generator, *shape: int, zeros: float = 0.0) -> np.ndarray:
    values = rng.uniform(0.02, 1.0, shape) * (rng.uniform(size=shape) >= zeros)
    values[..., 0] += 1e-3
    return values / values.sum(axis=-1, keepdims=True)


def random_network(
    rng: np.random.Generator, nodes: tuple[int, ...], columns: tuple[int, ...], *, inputs: int = 1
) -> Compiled:
    """Persistent nodes N0, N1, ... that depend on all of them before, and groups D0, D1, ... that
    depend on all of them now."""
    names = [f"N{k}" for k in range(len(nodes))]
    given = [previous(name) for name in names]
    tables = within("Input", [], np.full(inputs, 1 / inputs)) if inputs > 1 else []
    for name, size in zip(names, nodes, strict=True):
        chosen = ["Input"] if inputs > 1 else []
        shape = (inputs,) if inputs > 1 else ()
        tables += prior(name, random_rows(rng, *shape, size), chosen)
        rows = random_rows(rng, *shape, *nodes, size, zeros=0.2)
        tables += dynamics(name, [*chosen, *given], rows)
    observed = [f"D{k}" for k in range(len(columns))]
    for name, size in zip(observed, columns, strict=True):
        tables += within(name, names, random_rows(rng, *nodes, size))
    return compile(
        declare(tables, observed),
        hidden=names,
        observed=observed,
        inputs=["Input"] if inputs > 1 else [],
    )


def random_evidence(
    rng: np.random.Generator, compiled: Compiled, n_frames: int, zeros: float = 0.0
) -> Evidence:
    likelihoods = {
        key: random_rows(rng, n_frames, compiled.cardinality[str(key)], zeros=zeros)
        for key in compiled.observed
    }
    inputs = {n: rng.integers(0, compiled.cardinality[n], n_frames) for n in compiled.inputs}
    return Evidence(likelihoods, inputs)


def checked(compiled: Compiled, evidence: Evidence, method: str) -> Beliefs:
    """The beliefs, which are the reference's."""
    ours = filter_beliefs(compiled, evidence, method)
    right = reference.filter_beliefs(compiled, evidence, method)
    assert_same_beliefs(ours, right, 1e-12 * max(1.0, np.abs(right.log_evidence).max()))
    return ours


@every_method
@pytest.mark.parametrize(("nodes", "columns"), SIZES)
def test_the_recursion_equals_the_reference(
    nodes: tuple[int, ...], columns: tuple[int, ...], method: str
) -> None:
    for seed in range(8 if IS_COMPILED else 2):
        rng = np.random.default_rng(seed)
        compiled = random_network(rng, nodes, columns)
        checked(compiled, random_evidence(rng, compiled, 40, zeros=seed % 3 * 0.2), method)


@every_method
def test_so_it_does_around_impossible_frames(method: str) -> None:
    rng = np.random.default_rng(3)
    compiled = random_network(rng, (4, 2), (4, 2))
    evidence = random_evidence(rng, compiled, 60)
    impossible = np.isin(np.arange(60), [0, 7, 8, 9, 10, 11, 30, 59])
    evidence.likelihoods["D0"][impossible] = 0.0
    assert np.array_equal(checked(compiled, evidence, method).is_impossible, impossible)


@every_method
@pytest.mark.parametrize("scale", [1e-130, 1e-30, 1e30, 1e130])
def test_likelihoods_of_any_size_are_scaled_not_lost(scale: float, method: str) -> None:
    rng = np.random.default_rng(4)
    compiled = random_network(rng, (4, 2), (4, 2))
    evidence = random_evidence(rng, compiled, 40)
    before = checked(compiled, evidence, method)
    for values in evidence.likelihoods.values():
        values[10:20] *= scale
    after = checked(compiled, evidence, method)
    assert not after.is_impossible.any()
    for name in before.marginals:
        np.testing.assert_allclose(
            after.marginals[name], before.marginals[name], rtol=0, atol=1e-12
        )


@every_method
def test_pieces_that_the_filter_takes_one_by_one_equal_the_whole(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(9)
    compiled = random_network(rng, (4, 2), (4, 2))
    evidence = random_evidence(rng, compiled, 50)
    monkeypatch.setattr(filtering, "MIN_FIXED_FRAMES", 1)
    monkeypatch.setattr(filtering, "PIECE", 8 * 7)
    assert compiled.n_states == 8
    beliefs = checked(compiled, evidence, method)
    np.testing.assert_array_equal(beliefs.frame_id, np.arange(50))


@every_method
@pytest.mark.parametrize("nodes", [(3, 2), (5, 4)])
def test_inputs_select_the_transition_whatever_the_size(
    nodes: tuple[int, ...], method: str
) -> None:
    rng = np.random.default_rng(7)
    compiled = random_network(rng, nodes, (3, 2), inputs=3)
    checked(compiled, random_evidence(rng, compiled, 20, zeros=0.2), method)


def test_the_likelihood_is_the_references() -> None:
    rng = np.random.default_rng(8)
    compiled = random_network(rng, (4, 2), (4, 2, 3))
    evidence = random_evidence(rng, compiled, 30)
    for k, values in enumerate(evidence.likelihoods.values()):
        values[3 * k : 3 * k + 6] *= 10.0 ** rng.choice([-90, -30, 30, 90], 6)[:, None]
    evidence.likelihoods["D1"][20] = 0.0
    ours = state_likelihood(compiled, evidence)
    right, scale = reference.state_likelihood(compiled, evidence)
    with np.errstate(divide="ignore"):
        ours, right = np.log(ours), np.log(right) + scale[:, None]
    np.testing.assert_allclose(ours, right, rtol=1e-12, atol=1e-12)


@pytest.mark.skipif(not IS_COMPILED, reason="nothing is compiled with NUMBA_DISABLE_JIT")
def test_a_second_process_loads_the_kernels_instead_of_compiling_them(tmp_path) -> None:  # type: ignore[no-untyped-def]
    program = """
import numpy as np
from egolane_pgm.inference.kernels.filter import likelihood_kernel
for sizes in ((2, 3), (3, 2)):
    run = likelihood_kernel(*sizes)
    frames = np.ones((4, sizes[0]))
    run(np.ones((4, sizes[1])), np.ones(sizes[::-1]), frames)
    assert (frames == sizes[1]).all()
    print(sum(run.stats.cache_hits.values()), sum(run.stats.cache_misses.values()))
"""
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(tmp_path))
    said = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for _ in range(2)
    ]
    assert said == [["0", "1"] * 2, ["1", "0"] * 2]
