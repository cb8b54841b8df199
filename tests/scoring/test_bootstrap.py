"""Blocks, held-out scores and block-bootstrap intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import (
    bootstrap_interval,
    circular_block_bootstrap,
    confusion_counts,
    mean_counts,
    paired_difference_interval,
    ratio,
    resampled_sums,
)
from egolane_pgm.scoring.confusion import accuracy, confusion, macro_f1
from egolane_pgm.scoring.held_out import blocks, confusion_by_block, held_out, held_out_confusion
from egolane_pgm.types import InputError


def a_drive(n_frames: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """assigned (right in four of five), lane, is_crossing for 3 lanes."""
    rng = np.random.default_rng(seed)
    lane = np.repeat(rng.integers(1, 4, n_frames), 20)[:n_frames]
    assigned = np.where(rng.random(n_frames) < 0.8, lane, rng.integers(0, 4, n_frames))
    return assigned, lane, rng.random(n_frames) < 0.1


@given(st.integers(2, 12), st.integers(0, 60))
def test_blocks_are_contiguous_complete_and_of_nearly_equal_length(n: int, more: int) -> None:
    parts = blocks(n + more, n)
    assert len(parts) == n
    assert np.concatenate(parts).tolist() == list(range(n + more))
    lengths = [len(part) for part in parts]
    assert max(lengths) - min(lengths) <= 1
    assert lengths == sorted(lengths, reverse=True)


def test_five_blocks_are_the_default() -> None:
    assert [part.tolist() for part in blocks(7)] == [[0, 1], [2, 3], [4], [5], [6]]


def test_impossible_numbers_of_blocks_are_refused() -> None:
    with pytest.raises(InputError, match="n_blocks: 1 must be at least 2"):
        blocks(10, 1)
    with pytest.raises(InputError, match="5 blocks are more than the 4 frames"):
        blocks(4, 5)


def belief_of(lane: np.ndarray, n_lanes: int) -> np.ndarray:
    return np.eye(n_lanes)[lane - 1]


def test_a_block_is_believed_with_what_was_fitted_on_the_others_only() -> None:
    seen: list[list[int]] = []

    def fit(train: np.ndarray) -> int:
        seen.append(train.tolist())
        return len(seen)  # the parameters of block b are the number b

    def predict(b: int) -> np.ndarray:
        return np.full((7, 4), 0.1) + 0.6 * np.eye(4)[b - 1]

    result = held_out(7, 3, fit, predict)
    assert seen == [[3, 4, 5, 6], [0, 1, 2, 5, 6], [0, 1, 2, 3, 4]]
    assert result.block.tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert result.parameters == (1, 2, 3)
    assert assigned_lane(result.belief).tolist() == [1, 1, 1, 2, 2, 3, 3]


def test_excluded_frames_are_predicted_and_scored_but_never_fitted_on() -> None:
    seen: list[list[int]] = []

    def fit(train: np.ndarray) -> None:
        seen.append(train.tolist())

    exclude = np.array([True, False, False, True, False, False])
    matrix, result = held_out_confusion(
        6,
        2,
        fit,
        lambda _: belief_of(np.array([1, 1, 1, 2, 2, 2]), 2),
        lane=np.array([1, 1, 2, 2, 2, 2]),
        is_crossing=np.array([False, True, False, False, False, False]),
        fit_exclude=exclude,
    )
    assert seen == [[4, 5], [1, 2]]
    assert len(result.belief) == 6
    assert matrix.tolist() == [[1, 1], [0, 3], [0, 0]]


def test_the_confusions_of_the_blocks_add_up_to_the_one_of_the_stitched_belief() -> None:
    assigned, lane, is_crossing = a_drive(101)
    rng = np.random.default_rng(1)

    def predict(seed: int) -> np.ndarray:
        noise = np.random.default_rng(seed).dirichlet(np.ones(3), 101)
        return np.asarray(0.5 * noise + 0.5 * belief_of(np.maximum(assigned, 1), 3))

    matrix, result = held_out_confusion(
        101, 4, lambda _: int(rng.integers(1000)), predict, lane=lane, is_crossing=is_crossing
    )
    by_block = confusion_by_block(result, lane, is_crossing)
    assert by_block.shape == (4, 4, 3)
    stitched = confusion(assigned_lane(result.belief), lane, is_crossing, 3)
    np.testing.assert_array_equal(matrix, stitched)
    np.testing.assert_array_equal(by_block.sum(axis=0), stitched)
    for b, part in enumerate(blocks(101, 4)):
        ours = confusion(
            assigned_lane(predict(result.parameters[b]))[part], lane[part], is_crossing[part], 3
        )
        np.testing.assert_array_equal(by_block[b], ours)


def test_a_fit_that_cannot_see_the_block_scores_worse_there_than_one_that_can() -> None:
    # Each block is driven in a lane of its own; "fitting" is to count the lanes of the frames seen.
    lane = np.repeat([1, 2, 3], 10)

    def fit(train: np.ndarray) -> np.ndarray:
        return np.bincount(lane[train] - 1, minlength=3) / len(train)

    matrix, _ = held_out_confusion(
        30, 3, fit, lambda p: np.tile(p, (30, 1)), lane=lane, is_crossing=np.zeros(30, bool)
    )
    assert accuracy(matrix) == 0


def test_held_out_refuses_what_it_cannot_do() -> None:
    good = np.full((6, 2), 0.5)
    with pytest.raises(InputError, match="block 2 of 2: no frame is left to fit on"):
        held_out(6, 2, len, lambda _: good, fit_exclude=[True] * 3 + [False] * 3)
    with pytest.raises(InputError, match=r"block 1 of 2: predict gave .* \(3, 2\), needs \(6, 2\)"):
        held_out(6, 2, len, lambda _: good[:3])
    with pytest.raises(InputError, match="sums to 2"):
        held_out(6, 2, len, lambda _: 2 * good)
    with pytest.raises(InputError, match="fit_exclude has shape"):
        held_out(6, 2, len, lambda _: good, fit_exclude=[True])
    predictions = iter([good, np.full((6, 3), 1 / 3)])
    with pytest.raises(InputError, match=r"block 2 of 2: predict gave .* \(6, 3\)"):
        held_out(6, 2, len, lambda _: next(predictions))


def test_a_resample_is_made_of_whole_circular_blocks_cut_to_the_length_of_the_drive() -> None:
    drawn = circular_block_bootstrap(23, block=5, resamples=50, seed=3)
    assert len(drawn) == 50
    for starts, frames in zip(drawn.starts, drawn, strict=True):
        assert len(frames) == 23
        expected = [(s + k) % 23 for s in starts for k in range(5)][:23]
        assert frames.tolist() == expected


def test_the_resamples_depend_on_the_seed_and_on_nothing_else() -> None:
    a, b = circular_block_bootstrap(1000), circular_block_bootstrap(1000)
    assert a.starts.shape == (2000, 4)
    np.testing.assert_array_equal(a.starts, b.starts)
    assert (circular_block_bootstrap(1000, seed=1).starts != a.starts).any()


def test_every_frame_is_resampled_equally_often_on_average() -> None:
    drawn = circular_block_bootstrap(40, block=10, resamples=4000, seed=0)
    counts = np.bincount(np.concatenate(list(drawn)), minlength=40) / 4000
    # Each count has mean 1 and, with 4 blocks of a quarter each, variance 0.75.
    assert np.abs(counts - 1).max() < 5 * math.sqrt(0.75 / 4000)


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
    drawn = circular_block_bootstrap(n_frames, block, 7, seed)
    expected = np.stack([values[frames].sum(axis=0) for frames in drawn])
    sums = resampled_sums(values, drawn)
    assert sums.shape == expected.shape
    np.testing.assert_allclose(sums, expected, rtol=1e-12)


def test_sums_taken_in_pieces_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).integers(0, 9, (100, 4))
    drawn = circular_block_bootstrap(100, 7, 50)
    at_once = resampled_sums(values, drawn)
    monkeypatch.setattr("egolane_pgm.scoring.bootstrap._CHUNK", 1)
    np.testing.assert_array_equal(resampled_sums(values, drawn), at_once)


def test_a_frame_counts_in_the_cell_of_its_confusion_and_a_crossing_one_in_none() -> None:
    assigned, lane, is_crossing = a_drive(200)
    counts = confusion_counts(assigned, lane, is_crossing, 3)
    assert counts.shape == (200, 4, 3)
    np.testing.assert_array_equal(counts.sum(axis=(1, 2)), ~is_crossing)
    for k in range(200):
        one = slice(k, k + 1)
        np.testing.assert_array_equal(
            counts[k], confusion(assigned[one], lane[one], is_crossing[one], 3)
        )


def test_the_interval_is_the_percentiles_of_the_statistic_over_the_resamples() -> None:
    assigned, lane, is_crossing = a_drive(300)
    counts = confusion_counts(assigned, lane, is_crossing, 3)
    for statistic in (accuracy, macro_f1):
        interval = bootstrap_interval(counts, statistic, block=20, resamples=200, seed=4, level=0.9)
        slow = [
            statistic(confusion(assigned[f], lane[f], is_crossing[f], 3))
            for f in circular_block_bootstrap(300, 20, 200, 4)
        ]
        assert interval.low == pytest.approx(np.quantile(slow, 0.05))
        assert interval.high == pytest.approx(np.quantile(slow, 0.95))
        assert interval.estimate == pytest.approx(
            statistic(confusion(assigned, lane, is_crossing, 3))
        )
        assert interval.low < interval.estimate < interval.high


def test_a_constant_has_an_interval_of_no_width() -> None:
    interval = bootstrap_interval(mean_counts(np.full(700, 0.3)), ratio)
    assert (interval.estimate, interval.low, interval.high) == pytest.approx((0.3, 0.3, 0.3))


def test_about_95_of_100_intervals_hold_the_truth_and_single_frames_would_not_do() -> None:
    # Runs of 20 equal coin tosses: neighbouring frames say the same, as in a drive.
    held, held_by_single_frames = 0, 0
    for seed in range(100):
        tosses = np.repeat(np.random.default_rng(seed).random(100) < 0.5, 20)
        counts = mean_counts(tosses)
        interval = bootstrap_interval(counts, ratio, block=100, resamples=150, seed=seed)
        held += interval.low <= 0.5 <= interval.high
        narrow = bootstrap_interval(counts, ratio, block=1, resamples=150, seed=seed)
        held_by_single_frames += narrow.low <= 0.5 <= narrow.high
    assert 85 <= held <= 99
    assert held_by_single_frames < 60


def test_frames_that_do_not_count_are_in_neither_part_of_the_mean() -> None:
    values = np.array([1.0, np.nan, 3.0])
    counts = mean_counts(values, [True, False, True])
    assert counts.tolist() == [[1, 1], [0, 0], [3, 1]]
    assert ratio(counts.sum(axis=0)) == 2


def test_where_nothing_counts_the_interval_is_nan() -> None:
    interval = bootstrap_interval(mean_counts(np.ones(40), [False] * 40), ratio, block=10)
    assert all(math.isnan(x) for x in (interval.estimate, interval.low, interval.high))


def test_resamples_in_which_the_statistic_is_undefined_are_left_out() -> None:
    # One frame of 40 counts; about a third of the resamples miss it.
    interval = bootstrap_interval(
        mean_counts(np.full(40, 5.0), np.arange(40) == 7), ratio, block=10
    )
    assert (interval.low, interval.high) == (5, 5)


def test_a_difference_uses_the_same_resamples_for_both_sides() -> None:
    assigned, lane, is_crossing = a_drive(400)
    a = confusion_counts(assigned, lane, is_crossing, 3)
    same = paired_difference_interval(a, a, macro_f1, block=20, resamples=100)
    assert (same.estimate, same.low, same.high) == (0, 0, 0)

    worse = assigned.copy()
    worse[::4] = 0
    b = confusion_counts(worse, lane, is_crossing, 3)
    interval = paired_difference_interval(a, b, accuracy, block=20, resamples=100, seed=2)
    slow = [
        accuracy(a[f].sum(axis=0)) - accuracy(b[f].sum(axis=0))
        for f in circular_block_bootstrap(400, 20, 100, 2)
    ]
    assert interval.low == pytest.approx(np.quantile(slow, 0.025))
    assert interval.high == pytest.approx(np.quantile(slow, 0.975))
    assert interval.low > 0
    whole = accuracy(a.sum(axis=0)) - accuracy(b.sum(axis=0))
    assert interval.estimate == pytest.approx(float(whole), abs=1e-12)
    turned = paired_difference_interval(b, a, accuracy, block=20, resamples=100, seed=2)
    assert (turned.estimate, turned.low) == pytest.approx((-interval.estimate, -interval.high))


def test_impossible_resamples_are_refused() -> None:
    with pytest.raises(InputError, match=r"599 frames are too few .* at least 600 are needed"):
        circular_block_bootstrap(599)
    with pytest.raises(InputError, match="block: 0"):
        circular_block_bootstrap(100, block=0)
    with pytest.raises(InputError, match="resamples: 0"):
        circular_block_bootstrap(100, block=10, resamples=0)
    counts = mean_counts(np.ones(100))
    for level in (0, 1, 95):
        with pytest.raises(InputError, match="level"):
            bootstrap_interval(counts, ratio, block=10, level=level)
    with pytest.raises(InputError, match="same frames on both sides, got 100 and 99"):
        paired_difference_interval(counts, counts[:99], ratio, block=10)
    with pytest.raises(InputError, match="resamples of 100 frames"):
        resampled_sums(np.ones(99), circular_block_bootstrap(100, 10, 5))
    with pytest.raises(InputError, match="need one per frame"):
        mean_counts(np.ones((3, 2)))
