"""Clips by the metric of the TuSimple lane challenge: MLD is no worse than its authors' output."""

from __future__ import annotations

import pytest

from makers.camera import clips


@pytest.mark.parametrize("as_written", [True, False])
def test_mld_is_better_than_what_its_authors_wrote(as_written: bool) -> None:
    folder = clips.data()
    if folder is None:
        pytest.skip("camera/tusimple_clips: needs EGOLANE_DATA with it")
    ours, theirs = (
        clips.challenge_score(folder, found, as_written=as_written)
        for found in (clips.columns(folder, "mld"), clips.theirs(folder))
    )
    assert ours.accuracy > theirs.accuracy
    assert ours.fp < theirs.fp
    assert ours.fn < theirs.fn
    if as_written:
        # Reached: .845, .250, .225.
        assert ours.accuracy >= 0.80
        assert ours.fp <= 0.26
        assert ours.fn <= 0.31
