"""Scores of searches with several seeds: means, and intervals over frames and seeds."""

from __future__ import annotations

import numpy as np
import pytest

from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.seeds import (
    mean_of,
    on_timeline,
    over_seeds,
    resampled_scores,
    spread,
    with_bounds,
)

N_FRAMES = 900


def counts_of(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    belief = rng.dirichlet(np.ones(3), N_FRAMES)
    lane = np.repeat([1, 2, 3], N_FRAMES // 3)
    return score_counts(belief, lane, np.arange(N_FRAMES) % 50 == 0)


def test_with_one_seed_it_is_the_paired_block_bootstrap() -> None:
    mine, theirs = counts_of(0), counts_of(1)
    expected = score_intervals([mine], [theirs])
    first, second = (resampled_scores([counts]) for counts in (mine, theirs))
    assert first is not None
    assert second is not None
    for name, interval in expected.items():
        assert interval is not None
        values = over_seeds(first[name], "a") - over_seeds(second[name], "b")
        found = with_bounds(values)
        assert found == pytest.approx([interval.estimate, interval.low, interval.high])


def test_what_the_seeds_leave_open_is_in_the_interval() -> None:
    """Without any luck of the frames, the mean of n seeds drawn of n varies by their spread."""
    scores = np.array([0.7, 0.8, 0.9, 0.6])
    values = np.repeat(scores[:, None], 4001, axis=1)
    mean = over_seeds(values, "run 1: a")
    assert mean[0] == pytest.approx(0.75)
    assert np.std(mean[1:]) == pytest.approx(np.std(scores) / 2, rel=0.05)
    assert np.mean(mean[1:]) == pytest.approx(0.75, abs=0.005)
    np.testing.assert_array_equal(mean, over_seeds(values, "run 1: a"))
    other = over_seeds(values, "run 1: b")
    assert abs(np.corrcoef(mean[1:], other[1:])[0, 1]) < 0.1


def test_seeds_that_agree_leave_the_interval_of_the_frames() -> None:
    one = resampled_scores([counts_of(0)])
    three = resampled_scores([counts_of(0)] * 3)
    assert one is not None
    assert three is not None
    for name, values in one.items():
        np.testing.assert_allclose(over_seeds(three[name], "a"), values[0])


def test_frames_that_one_recording_lacks_count_nothing_on_the_timeline_of_the_drive() -> None:
    counts = {name: values[::2] for name, values in counts_of(0).items()}
    frames = np.arange(0, 2 * N_FRAMES, 4)
    placed = on_timeline(counts, frames, np.arange(0, 2 * N_FRAMES, 2))
    for name, values in placed.items():
        np.testing.assert_array_equal(values[::2], counts[name])
        assert not values[1::2].any()


def test_the_mean_of_scores_keeps_their_form() -> None:
    first = {"accuracy": 0.5, "delay": {"p90": None, "changes": 3}, "per_lane": [0.0, 1.0]}
    second = {"accuracy": 1.0, "delay": {"p90": 2.0, "changes": 3}, "per_lane": [1.0, 1.0]}
    assert mean_of([first, second]) == {
        "accuracy": 0.75,
        "delay": {"p90": None, "changes": 3},
        "per_lane": [0.5, 1.0],
    }
    assert mean_of([first]) == first
    assert spread([0.5]) is None
    assert spread([0.5, 1.0]) == pytest.approx(np.sqrt(0.125))
