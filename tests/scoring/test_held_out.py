"""The held-out engine: blocks, what a fit is given, and what is kept of each block's belief."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import accuracy, confusion
from egolane_pgm.scoring.held_out import blocks, held_out, stitched, without_block
from egolane_pgm.types import Beliefs, InputError


@dataclass(frozen=True)
class Labels:
    """A drive that is nothing but labels; 0 where they were removed."""

    lane: np.ndarray
    never_fit: tuple[int, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.lane)

    @property
    def may_fit(self) -> np.ndarray:
        return ~np.isin(np.arange(len(self)), self.never_fit)

    def only_labels_of(self, train: np.ndarray) -> Labels:
        lane = np.zeros_like(self.lane)
        lane[train] = self.lane[train]
        return replace(self, lane=lane)


def beliefs_of(lane: np.ndarray) -> Beliefs:
    """A belief (T, n) as all that is believed; the log evidence is the number of the frame."""
    n_frames = len(lane)
    frames = np.arange(n_frames)
    return Beliefs(frames, {"Lane": lane}, frames.astype(float), np.zeros(n_frames, dtype=bool))


def sure(lane: np.ndarray, n_lanes: int) -> Beliefs:
    return beliefs_of(np.eye(n_lanes)[lane - 1])


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


def test_a_block_is_believed_with_what_was_fitted_on_the_others_only() -> None:
    seen: list[list[int]] = []

    def fit(drive: Labels, train: np.ndarray, block: int) -> int:
        seen.append(train.tolist())
        return block

    def believe(b: int) -> Beliefs:
        return beliefs_of(np.full((7, 4), 0.1) + 0.6 * np.eye(4)[b])

    result = held_out(Labels(np.ones(7, dtype=int)), fit, believe, 3)
    assert seen == [[3, 4, 5, 6], [0, 1, 2, 5, 6], [0, 1, 2, 3, 4]]
    assert result.block.tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert result.parameters == (0, 1, 2)
    assert assigned_lane(result.beliefs.lane).tolist() == [1, 1, 1, 2, 2, 3, 3]
    assert result.beliefs.log_evidence.tolist() == list(range(7))


def test_the_labels_of_the_block_and_those_not_trusted_are_not_in_what_a_fit_is_given() -> None:
    drive = Labels(np.array([1, 1, 2, 2, 1, 2]), never_fit=(0, 3))
    given: list[list[int]] = []

    def fit(seen: Labels, train: np.ndarray, block: int) -> None:
        given.append(seen.lane.tolist())
        assert np.flatnonzero(seen.lane).tolist() == train.tolist()

    held_out(drive, fit, lambda _: sure(drive.lane, 2), 2)
    assert given == [[0, 0, 0, 0, 1, 2], [0, 1, 2, 0, 0, 0]]


def test_frames_that_are_never_fit_are_believed_all_the_same() -> None:
    drive = Labels(np.array([1, 1, 2, 2, 2, 2]), never_fit=(0, 3))
    result = held_out(drive, lambda *_: None, lambda _: sure(np.array([1, 1, 1, 2, 2, 2]), 2), 2)
    matrix = confusion(assigned_lane(result.beliefs.lane), drive.lane, [False] * 6, 2)
    assert matrix.tolist() == [[2, 1], [0, 3], [0, 0]]


def test_a_fit_that_cannot_see_the_block_scores_worse_there_than_one_that_can() -> None:
    # Each block is driven in a lane of its own; "fitting" is to count the lanes of the frames seen.
    lane = np.repeat([1, 2, 3], 10)

    def fit(seen: Labels, train: np.ndarray, block: int) -> np.ndarray:
        return np.bincount(seen.lane, minlength=4)[1:] / len(train)

    result = held_out(Labels(lane), fit, lambda p: beliefs_of(np.tile(p, (30, 1))), 3)
    matrix = confusion(assigned_lane(result.beliefs.lane), lane, np.zeros(30, bool), 3)
    assert accuracy(matrix) == 0


def test_beliefs_are_stitched_block_by_block_in_everything_that_they_hold() -> None:
    rng = np.random.default_rng(0)
    each = [
        Beliefs(
            np.arange(11),
            {"Lane": rng.random((11, 3)), "Sensor": rng.random((11, 2))},
            rng.random(11),
            rng.random(11) < 0.5,
        )
        for _ in range(4)
    ]
    found = stitched(each)
    assert len(found) == 11
    for one, part in zip(each, blocks(11, 4), strict=True):
        for node in ("Lane", "Sensor"):
            np.testing.assert_array_equal(found.marginals[node][part], one.marginals[node][part])
        np.testing.assert_array_equal(found.log_evidence[part], one.log_evidence[part])
        np.testing.assert_array_equal(found.is_impossible[part], one.is_impossible[part])


def test_held_out_refuses_what_it_cannot_do() -> None:
    drive, good = Labels(np.ones(6, dtype=int)), np.full((6, 2), 0.5)

    def tried(believed: np.ndarray, drive: Labels = drive) -> Any:
        return held_out(drive, lambda *_: None, lambda _: beliefs_of(believed), 2)

    with pytest.raises(InputError, match="block 2 of 2: no frame is left to fit on"):
        tried(good, replace(drive, never_fit=(0, 1, 2)))
    with pytest.raises(InputError, match="block 2 of 2: no frame is left to fit on"):
        without_block(replace(drive, never_fit=(0, 1, 2)), 2, 1)
    with pytest.raises(InputError, match="block 1 of 2: beliefs of 3 frames, not of 6"):
        tried(good[:3])
