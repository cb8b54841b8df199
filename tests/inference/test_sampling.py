"""Draws from networks, against brute force and exact marginals."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.stats import chisquare

from egolane_pgm.inference.sampling import (
    drawn_paths,
    posterior_paths,
    predicted,
    sample,
    sampled_states,
)
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.types import Evidence, InputError
from tests.conformance.networks import draw_evidence, random_network, template
from tests.kits.trajectories import enumerated_paths

#: With so many tests at this level about one seed in a hundred fails one of them by chance.
LEVEL = 1e-4


def assert_drawn_from(counts: Counter, right: dict) -> None:
    """The counts may come from this distribution (a chi-squared test), and nothing else occurs."""
    n = sum(counts.values())
    assert set(counts) <= {value for value, p in right.items() if p > 0}
    # Rare values together, as the test needs some of each.
    expected = {value: n * p for value, p in right.items()}
    common = [value for value in expected if expected[value] >= 5]
    seen = np.array([counts[value] for value in common] + [0.0])
    wanted = np.array([expected[value] for value in common] + [0.0])
    seen[-1], wanted[-1] = n - seen.sum(), n - wanted.sum()
    kept = wanted > 1e-9
    if kept.sum() > 1:
        assert (
            chisquare(seen[kept], wanted[kept] * seen[kept].sum() / wanted[kept].sum()).pvalue
            > LEVEL
        )


def no_evidence(compiled, n_frames: int) -> Evidence:
    """Evidence that says nothing, with the inputs of the first frames at 0."""
    drawn = draw_evidence(compiled, n_frames, np.random.default_rng(0))
    blank = {key: np.ones_like(values) for key, values in drawn.likelihoods.items()}
    return Evidence(blank, {name: np.zeros(n_frames, np.int64) for name in compiled.inputs})


@pytest.mark.parametrize("seed", range(13))
def test_drives_are_drawn_from_the_tables(seed: int) -> None:
    """All nodes of both frames, hidden and observed, against all trajectories."""
    drawn, compiled = random_network(seed)
    nodes = [name for name in compiled.values if name not in compiled.inputs]
    right = enumerated_paths(drawn.tables, nodes, no_evidence(compiled, 2))
    inputs = {name: [0, 0] for name in compiled.inputs}
    counts: Counter = Counter()
    for k in range(600):
        drive = sample(compiled, 2, k, inputs=inputs)
        codes = np.stack([drive[name].cat.codes for name in nodes], axis=1)
        counts[tuple(map(tuple, codes.tolist()))] += 1
    assert_drawn_from(counts, right)


@pytest.mark.parametrize("seed", range(13))
def test_paths_are_drawn_from_the_posterior(seed: int) -> None:
    drawn, compiled = random_network(seed)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(seed))
    right = enumerated_paths(drawn.tables, drawn.hidden, evidence)
    total = sum(right.values())
    paths = drawn_paths(compiled, evidence, 20_000, seed)
    rows = np.stack([paths[name] for name in drawn.hidden], axis=-1)
    counts = Counter(tuple(map(tuple, row)) for row in rows.tolist())
    assert_drawn_from(counts, {path: p / total for path, p in right.items()})


@pytest.mark.parametrize("seed", range(13))
def test_what_is_predicted_ignores_the_evidence_of_its_frame(seed: int) -> None:
    drawn, compiled = random_network(seed)
    evidence = draw_evidence(compiled, 3, np.random.default_rng(seed))
    found = predicted(compiled, evidence)
    for t in range(3):
        blank = {key: values[: t + 1].copy() for key, values in evidence.likelihoods.items()}
        for values in blank.values():
            values[t] = 1.0
        seen = Evidence(blank, {k: v[: t + 1] for k, v in evidence.inputs.items()})
        for name in found:
            right = np.zeros(compiled.cardinality[name])
            for path, p in enumerated_paths(drawn.tables, [name], seen).items():
                right[path[-1][0]] += p
            np.testing.assert_allclose(found[name][t], right / right.sum(), atol=1e-9)


def test_sequences_are_drawn_and_predicted_apart() -> None:
    compiled = template("sensor_failure", 3)
    evidence = draw_evidence(compiled, 40, np.random.default_rng(3), zeros=0)
    is_first = np.isin(np.arange(40), (0, 25))
    paths = drawn_paths(compiled, evidence, 20_000, 0, is_first=is_first)
    for part in (slice(0, 25), slice(25, 40)):
        alone = smooth_beliefs(compiled, evidence.take(part))
        share = (paths["Lane"][:, part, None] == np.arange(3)).mean(axis=0)
        np.testing.assert_allclose(share, alone.lane, atol=0.02)
        ours = predicted(compiled, evidence, is_first=is_first)["WOR"][part]
        np.testing.assert_array_equal(ours, predicted(compiled, evidence.take(part))["WOR"])


def test_a_seed_gives_the_same_draws_and_another_seed_others() -> None:
    compiled = template("sensor_failure", 4)
    assert sample(compiled, 200, 1).equals(sample(compiled, 200, 1))
    assert not sample(compiled, 200, 1).equals(sample(compiled, 200, 2))


def test_wrong_numbers_are_refused() -> None:
    compiled = template("sensor_failure", 2)
    evidence = draw_evidence(compiled, 2, np.random.default_rng(0))
    with pytest.raises(InputError, match="sample: 0 is not a positive number"):
        sample(compiled, 0, 0)
    with pytest.raises(InputError, match="sample: 0 is not a positive number"):
        sampled_states(compiled, 3, 0, np.random.default_rng(0))
    with pytest.raises(InputError, match="posterior_paths: n: 0 is not a positive number"):
        posterior_paths(compiled, evidence, 0, 0)
    with pytest.raises(InputError, match=r"is_first: shape \(3,\), the evidence has 2 frames"):
        predicted(compiled, evidence, is_first=np.zeros(3, dtype=bool))


def test_paths_have_a_row_per_frame_and_the_names_of_the_values() -> None:
    compiled = template("sensor_failure", 2)
    evidence = draw_evidence(compiled, 5, np.random.default_rng(0), zeros=0)
    paths, codes = posterior_paths(compiled, evidence, 3, 0), drawn_paths(compiled, evidence, 3, 0)
    best = viterbi(compiled, evidence, frame_id=np.arange(7, 12)).states
    assert paths.index.names == ["path", "frame"]
    assert best.index.tolist() == [7, 8, 9, 10, 11]
    for name, values in {"Lane": ["1", "2"], "SensorState": ["0", "1"]}.items():
        assert list(paths[name].cat.categories) == list(best[name].cat.categories) == values
        np.testing.assert_array_equal(paths.loc[1, name].cat.codes, codes[name][1])
