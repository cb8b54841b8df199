"""Block-bootstrap intervals: of one recording or several, of one side or a difference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.scoring.bootstrap import (
    beyond_chance,
    block_gains,
    bootstrap_interval,
    circular_blocks,
    resampled_sums,
    score_intervals,
)
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.types import InputError


def resampled(n_frames: int, block: int, resamples: int, seed: int) -> np.ndarray:
    """The frames (R, T) of the resamples of a drive."""
    starts = circular_blocks(n_frames, block, resamples, seed)
    frames = starts[:, :, None] + np.arange(block)
    return frames.reshape(resamples, -1)[:, :n_frames] % n_frames


def mean_counts(values: np.ndarray, is_counted: np.ndarray | None = None) -> np.ndarray:
    """Per frame (value, 1), or (0, 0) where it is not counted, for a ratio."""
    counted = np.ones(len(values)) if is_counted is None else is_counted
    return np.stack([values * counted, counted], axis=1)


accuracy, macro_f1, ratio = (SCORES[name].statistic for name in ("accuracy", "f1", "log_loss"))


def confusion_counts(
    assigned: np.ndarray, lane: np.ndarray, is_crossing: np.ndarray, n_lanes: int
) -> np.ndarray:
    belief = np.full((len(lane), n_lanes), 1 / n_lanes)
    return SCORES["accuracy"].summands(Answers(belief, lane, is_crossing, assigned))


def a_drive(n_frames: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """assigned (right in four of five), lane, is_crossing for 3 lanes."""
    rng = np.random.default_rng(seed)
    lane = np.repeat(rng.integers(1, 4, n_frames), 20)[:n_frames]
    assigned = np.where(rng.random(n_frames) < 0.8, lane, rng.integers(0, 4, n_frames))
    return assigned, lane, rng.random(n_frames) < 0.1


@settings(max_examples=60)
@given(
    st.integers(2, 60),
    st.integers(1, 30),
    st.sampled_from(["counts", "floats"]),
    st.integers(0, 99),
)
def test_sums_over_resamples_equal_indexing_frame_by_frame(
    n_frames: int, block: int, kind: str, seed: int
) -> None:
    block = min(block, n_frames // 2)
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 5, (n_frames, 3, 2)) if kind == "counts" else rng.random(n_frames)
    drawn = resampled(n_frames, block, 7, seed)
    expected = np.stack([values[frames].sum(axis=0) for frames in drawn])
    sums = resampled_sums(values, circular_blocks(n_frames, block, 7, seed), block)
    assert sums.shape == expected.shape
    np.testing.assert_allclose(sums, expected, rtol=1e-12)


def test_about_95_of_100_intervals_hold_the_truth_and_single_frames_would_not_do() -> None:
    # Runs of 20 equal coin tosses: neighbouring frames say the same, as in a drive.
    held, held_by_single_frames = 0, 0
    for seed in range(100):
        tosses = np.repeat(np.random.default_rng(seed).random(100) < 0.5, 20)
        counts = mean_counts(tosses)
        interval = bootstrap_interval([counts], ratio, block=100, resamples=150, seeds=[seed])
        held += interval.low <= 0.5 <= interval.high
        narrow = bootstrap_interval([counts], ratio, block=1, resamples=150, seeds=[seed])
        held_by_single_frames += narrow.low <= 0.5 <= narrow.high
    assert 85 <= held <= 99
    assert held_by_single_frames < 60


def test_resamples_in_which_the_statistic_is_undefined_are_left_out() -> None:
    # One frame of 40 counts, and about a third of the resamples miss it; or no frame counts.
    for counted, expected in ((np.arange(40) == 7, 5.0), (np.zeros(40), math.nan)):
        interval = bootstrap_interval([mean_counts(np.full(40, 5.0), counted)], ratio, block=10)
        np.testing.assert_equal((interval.low, interval.high), (expected, expected))


def test_a_difference_uses_the_same_resamples_for_both_sides() -> None:
    assigned, lane, is_crossing = a_drive(400)
    a = confusion_counts(assigned, lane, is_crossing, 3)
    same = bootstrap_interval([a], macro_f1, minus=[a], block=20, resamples=100)
    assert (same.estimate, same.low, same.high) == (0, 0, 0)

    worse = assigned.copy()
    worse[::4] = 0
    b = confusion_counts(worse, lane, is_crossing, 3)
    interval = bootstrap_interval([a], accuracy, minus=[b], block=20, resamples=100, seeds=[2])
    slow = [
        accuracy(a[f].sum(axis=0)) - accuracy(b[f].sum(axis=0)) for f in resampled(400, 20, 100, 2)
    ]
    assert interval.low == pytest.approx(np.quantile(slow, 0.025))
    assert interval.high == pytest.approx(np.quantile(slow, 0.975))
    assert interval.low > 0
    whole = accuracy(a.sum(axis=0)) - accuracy(b.sum(axis=0))
    assert interval.estimate == pytest.approx(float(whole), abs=1e-12)


def test_several_recordings_are_resampled_one_by_one_and_count_alike() -> None:
    drives = [a_drive(300, seed=1), a_drive(400, seed=2)]
    counts = [confusion_counts(*drive, 3) for drive in drives]
    for statistic in (accuracy, macro_f1):
        interval = bootstrap_interval(counts, statistic, block=20, resamples=100, seeds=[5, 6])
        slow = [
            [statistic(mine[f].sum(axis=0)) for f in resampled(len(mine), 20, 100, 5 + k)]
            for k, mine in enumerate(counts)
        ]
        assert interval.low == pytest.approx(np.quantile(np.mean(slow, axis=0), 0.025))
        assert interval.high == pytest.approx(np.quantile(np.mean(slow, axis=0), 0.975))
        each = [statistic(mine.sum(axis=0)) for mine in counts]
        assert interval.estimate == pytest.approx(np.mean(each))


def test_every_score_has_an_interval_and_a_short_drive_has_none() -> None:
    assigned, lane, is_crossing = a_drive(700)
    belief = 0.9 * np.eye(3)[np.maximum(assigned, 1) - 1] + 0.1 / 3
    both = [
        Answers(b, lane, is_crossing, assigned_lane(b), True, 10.0, b[:, 0])
        for b in (belief, np.roll(belief, 1, axis=1))
    ]
    sides = [{name: score.summands(each) for name, score in SCORES.items()} for each in both]
    found = score_intervals(sides[:1], sides[1:])
    assert list(found) == list(SCORES)
    for name, score in SCORES.items():
        mine, theirs = ([side[name]] for side in sides)
        assert found[name] == bootstrap_interval(mine, score.statistic, minus=theirs)
        assert found[name].estimate == pytest.approx(score.of(both[0]) - score.of(both[1]))
    short = {name: values[:599] for name, values in sides[0].items()}
    for name, interval in score_intervals([sides[0], short], [sides[1], short]).items():
        assert (interval.low, interval.high) == (None, None)
        assert interval.estimate == pytest.approx(found[name].estimate / 2)


def test_sides_of_different_lengths_are_refused() -> None:
    counts = mean_counts(np.ones(100))
    with pytest.raises(InputError, match="same frames on both sides, got 100 and 99"):
        bootstrap_interval([counts], ratio, minus=[counts[:99]], block=10)


# --- gains of the best of several candidates ------------------------------------------------------


def test_the_gain_of_a_mean_is_made_of_the_differences_of_its_blocks() -> None:
    """Two recordings of one drive share their blocks, and another drive has its own."""
    rng = np.random.default_rng(0)
    better, worse = ([mean_counts(rng.normal(size=n)) for n in (60, 60, 90)] for _ in range(2))
    found = block_gains(better, worse, ratio, [0, 0, 1], block=30)
    means = [(a - b)[:, 0].reshape(-1, 30).mean(axis=1) for a, b in zip(better, worse, strict=True)]
    drives = [(means[0] + means[1]) / 3 * 5 / 2, means[2] / 3 * 5 / 3]
    np.testing.assert_allclose(found, np.concatenate(drives))
    gain = bootstrap_interval(better, ratio, minus=worse, block=30).estimate
    assert found.mean() == pytest.approx(gain)


def test_chance_rarely_passes_and_a_clear_gain_does() -> None:
    """26 candidates without a gain, 12 blocks: one in twenty searches at most lets one pass."""
    rng = np.random.default_rng(0)
    passed = 0
    for _ in range(200):
        gains = rng.normal(size=(26, 12)) * rng.uniform(0.1, 2, (26, 1))
        passed += (gains.mean(axis=1) > beyond_chance(gains)[0]).any()
    # A clear loss with a large spread is no candidate.
    gains[:2] = rng.normal([[3], [-30]], [[0.5], [9]], (2, 12))
    least, selected = beyond_chance(gains)
    assert (gains.mean(axis=1) > least).tolist() == [True] + 25 * [False]
    assert selected[0] > 0.9
    assert beyond_chance(gains[:, :4])[0] == math.inf
    assert passed <= 0.05 * 200 + 2 * math.sqrt(200 * 0.05 * 0.95)
