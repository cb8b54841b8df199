"""Folds: what is trained on, what is held out, and which labels a fit sees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pandas.testing import assert_frame_equal

from egolane_pgm.drives import Drive
from egolane_pgm.loading import load_experiment
from egolane_pgm.running import frames_of
from egolane_pgm.studies import study
from egolane_pgm.studies.fits import Fitted, apply_fit
from egolane_pgm.studies.study import (
    block_folds,
    drive_folds,
    everything,
    fit_fold,
    fit_folds,
    group_folds,
)
from egolane_pgm.types import InputError
from tests.kits.drives import simulated, write_drive
from tests.kits.studies import drive_of, two_drives


def drive(**keys: Any) -> Drive:
    return drive_of(simulated(**keys))


def of_length(n: int) -> Drive:
    """A drive with n annotated frames."""
    whole = drive()
    lane = np.where(np.arange(len(whole.log)) < n, whole.true_lane, 0)
    return replace(whole, true_lane=lane)


@given(st.integers(2, 12), st.lists(st.integers(0, 60), min_size=1, max_size=3))
def test_blocks_are_contiguous_complete_and_of_nearly_equal_length(n: int, more: list[int]) -> None:
    drives = [of_length(n + each) for each in more]
    folds = block_folds(drives, n)
    assert len(folds) == n
    for k, each in enumerate(drives):
        parts = [fold.test[k] for fold in folds]
        assert np.concatenate(parts).tolist() == list(range(len(each)))
        lengths = [len(part) for part in parts]
        assert max(lengths) - min(lengths) <= 1
        for fold in folds:
            right = np.setdiff1d(np.arange(len(each)), fold.test[k])
            np.testing.assert_array_equal(fold.train[k], right)


def test_too_few_and_too_many_blocks_are_refused() -> None:
    for n in (1, 1201):
        with pytest.raises(InputError, match=f"folds: {n} is not between 2 and the 1200 frames"):
            block_folds([drive()], n)


def test_groups_of_drives_are_held_out_in_turn() -> None:
    drives = [*two_drives(), drive()]
    first, second = group_folds(drives, ["a", "b", "a"])
    whole = everything(drives)
    assert [len(t) for t in first.train] == [0, len(whole.train[1]), 0]
    assert [len(t) for t in first.test] == [len(whole.test[0]), 0, len(whole.test[2])]
    assert [len(t) for t in second.train] == [len(whole.train[0]), 0, len(whole.train[2])]


def test_recordings_of_one_drive_are_held_out_together(tmp_path: Path) -> None:
    """Two detectors on each of three drives."""
    drives = []
    for k, n_frames in enumerate((60, 70, 80)):
        for detector in "xy":
            path = write_drive(tmp_path / f"{k}{detector}", n_frames, name=f"{detector}{k}")
            drives.append(drive_of(load_experiment(path)))
    tagged = [replace(each, tags={"who": f"w{k // 4}"}) for k, each in enumerate(drives)]

    def out(folds: Any) -> list[list[int]]:
        return [[k for k, t in enumerate(fold.test) if len(t)] for fold in folds]

    assert out(drive_folds(drives, 5)) == [[0, 1], [2, 3], [4, 5]]
    assert out(drive_folds(drives, 2)) == [[0, 1, 2, 3], [4, 5]]
    assert out(drive_folds(tagged, 5, "who")) == [[0, 1, 2, 3], [4, 5]]
    split = [replace(each, tags={"who": f"w{k}"}) for k, each in enumerate(drives)]
    assert out(drive_folds(split, 5, "who")) == [[0, 1], [2, 3], [4, 5]]
    for some, tag, said in (
        (drives[:2], None, "folds: all rows are of one drive, so nothing"),
        (tagged, "woh", r"by_tag: x0 has no tag\.woh \(did you mean 'who'\?\)"),
    ):
        with pytest.raises(InputError, match=said):
            drive_folds(some, 5, tag)


def test_a_fit_sees_no_label_but_those_of_its_training_frames() -> None:
    drives = two_drives()
    fold = block_folds(drives, 3)[1]
    seen: list[Drive] = []

    def fit(given: Any, train: Any, number: Any) -> Fitted:
        seen.extend(given)
        assert number == 1
        np.testing.assert_array_equal(train[0], fold.train[0])
        return Fitted()

    fit_fold(drives, fit, (1, fold))
    for one, train, masked in zip(drives, fold.train, seen, strict=True):
        kept = one.rows[train]
        others = np.setdiff1d(one.rows, kept)
        np.testing.assert_array_equal(masked.true_lane[kept], one.true_lane[kept])
        assert (masked.true_lane[others] == 1).all()
        assert masked.is_crossing[others].all()
    # Drives that are held out as a whole are not passed on at all.
    seen.clear()
    fold = group_folds(drives, ["a", "b"])[1]
    fit_fold(drives, fit, (1, fold))
    assert [each.name for each in seen] == ["d0"]


def test_a_fold_without_a_training_frame_is_refused() -> None:
    one = drive(fit={"untrusted_frames": [[0, None]]})
    with pytest.raises(InputError, match="block 1: no frame is left to fit to; exclude fewer"):
        fit_fold([one], lambda *_: Fitted(), (0, block_folds([one])[0]))


def test_each_test_frame_has_the_posterior_of_its_own_fold() -> None:
    """Each drive is filtered from its first frame on, with the fit of the fold."""
    drives = two_drives()
    folds = block_folds(drives, 4)

    def fit(given: Any, train: Any, number: Any) -> Fitted:
        return Fitted(sigma1=0.1 + 0.3 * number)

    fitted = fit_folds(drives, fit, list(enumerate(folds)))
    frames = study.test_frames(drives, folds, fitted)
    assert [each["sigma1"] for each in fitted] == pytest.approx([0.1, 0.4, 0.7, 1.0])
    assert frames.index.tolist() == [i for each in drives for i in each.log.frame_id]
    for k, one in enumerate(drives):
        mine = frames[frames["drive"] == one.name]
        for b, fold in enumerate(folds):
            alone = frames_of(replace(one, model=apply_fit(one.model, fitted[b])))
            there = mine[mine["block"] == b]
            assert_frame_equal(there[alone.columns], alone.iloc[fold.test[k]])
