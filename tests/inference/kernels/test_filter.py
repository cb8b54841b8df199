"""The compiled recursion and likelihood, for any size and for sizes that are constants, against
plain NumPy, with awkward likelihoods."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, within
from egolane_pgm.inference import filtering
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.types import Evidence
from tests.conformance.networks import assert_same_beliefs
from tests.reference import inference as reference

#: Without the compiler everything is thousands of times slower, and one size is as good as ten.
IS_COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"

#: Persistent nodes' sizes, groups' columns, values of an input. Few, because each is compiled.
SIZES = [
    ((4, 2), (4, 2), 1),
    ((3, 2), (3, 2), 3),
    ((4,), (4,), 1),
    ((1,), (1,), 1),
    ((2, 3), (5, 1, 2), 1),
    ((5, 4), (3, 2), 3),
]
SIZES = SIZES if IS_COMPILED else SIZES[:1]

every_method = pytest.mark.parametrize("method", METHODS)


@pytest.fixture(params=["fixed sizes", "any size"])
def fixed_sizes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a test through both kernels, however short its sequences are."""
    least = 1 if request.param == "fixed sizes" else 10**9
    monkeypatch.setattr(filtering, "MIN_FIXED_FRAMES", least)


def random_rows(rng: np.random.Generator, *shape: int, zeros: float = 0.0) -> np.ndarray:
    values = rng.uniform(0.02, 1.0, shape) * (rng.uniform(size=shape) >= zeros)
    values[..., 0] += 1e-3
    return values / values.sum(axis=-1, keepdims=True)


def random_network(
    rng: np.random.Generator, nodes: tuple[int, ...], columns: tuple[int, ...], inputs: int
) -> Compiled:
    """Persistent nodes N0, N1, ... that depend on all of them before, and groups D0, D1, ... that
    depend on all of them now."""
    names = [f"N{k}" for k in range(len(nodes))]
    given = [previous(name) for name in names]
    tables = within("Input", [], np.full(inputs, 1 / inputs))
    for name, size in zip(names, nodes, strict=True):
        tables += prior(name, random_rows(rng, inputs, size), ["Input"])
        rows = random_rows(rng, inputs, *nodes, size, zeros=0.2)
        tables += dynamics(name, ["Input", *given], rows)
    observed = [f"D{k}" for k in range(len(columns))]
    for name, size in zip(observed, columns, strict=True):
        tables += within(name, names, random_rows(rng, *nodes, size))
    network = declare(tables, observed)
    return compile(network, hidden=names, observed=observed, inputs=["Input"])


@every_method
@pytest.mark.parametrize(("nodes", "columns", "inputs"), SIZES)
@pytest.mark.usefixtures("fixed_sizes")
def test_the_recursion_equals_the_reference(
    nodes: tuple[int, ...], columns: tuple[int, ...], inputs: int, method: str
) -> None:
    """With zeros, impossible frames, and likelihoods of any size, which are scaled, not lost."""
    impossible = np.isin(np.arange(60), [0, 7, 8, 9, 10, 11, 30, 59])
    for seed in range(6 if IS_COMPILED else 2):
        rng = np.random.default_rng(seed)
        compiled = random_network(rng, nodes, columns, inputs)
        likelihoods = {}
        for key, size in zip(compiled.observed, columns, strict=True):
            scale = 10.0 ** rng.choice([0, 0, -90, -30, 30, 90], 60)[:, None] if seed % 2 else 1
            likelihoods[key] = random_rows(rng, 60, size, zeros=seed % 3 * 0.2) * scale
        likelihoods["D0"][impossible] = 0.0
        evidence = Evidence(likelihoods, {"Input": rng.integers(0, inputs, 60)})
        ours = filter_beliefs(compiled, evidence, method)
        right = reference.filter_beliefs(compiled, evidence, method)
        assert_same_beliefs(ours, right, 1e-12 * max(1.0, np.abs(right.log_evidence).max()))
        assert ours.is_impossible[impossible].all()
        assert not ours.is_impossible.all()


@every_method
def test_chunks_that_the_filter_takes_one_by_one_equal_the_whole(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(9)
    compiled = random_network(rng, (4, 2), (4, 2), 1)
    likelihoods = {key: random_rows(rng, 50, size) for key, size in (("D0", 4), ("D1", 2))}
    evidence = Evidence(likelihoods, {"Input": np.zeros(50, dtype=int)})
    whole = filter_beliefs(compiled, evidence, method)
    monkeypatch.setattr(filtering, "PIECE", 7 * compiled.n_states)
    chunks = filter_beliefs(compiled, evidence, method)
    assert_same_beliefs(chunks, whole, 1e-13)
    np.testing.assert_array_equal(chunks.frame_id, np.arange(50))


@pytest.mark.skipif(not IS_COMPILED, reason="nothing is compiled with NUMBA_DISABLE_JIT")
def test_a_second_process_loads_the_kernels_instead_of_compiling_them(tmp_path) -> None:  # type: ignore[no-untyped-def]
    program = """
import numpy as np
from egolane_pgm.inference.kernels.filter import forward_kernel
for columns in ((0, 1),), ((0, 1, 2),):
    n, run = len(columns[0]), forward_kernel(columns)
    one, table = np.ones((1, n)), np.full((1, n, n), 1 / n)
    run(one[0], np.ones(1, bool), False, one / n, table, np.zeros(1, int), one,
        np.array(columns), one.copy(), np.ones(1), np.zeros(1, bool))
    print(sum(run.stats.cache_hits.values()), sum(run.stats.cache_misses.values()))
"""
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(tmp_path))
    values = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for _ in range(2)
    ]
    assert values == [["0", "1"] * 2, ["1", "0"] * 2]
