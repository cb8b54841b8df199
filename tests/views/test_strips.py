"""The strips show the beliefs of the right frames in the right rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.views.frames import frames_between
from egolane_pgm.views.strips import result_strips, strip_cells
from tests.kits.tiny_result import (
    DETECTOR,
    IDS,
    MODEL,
    a_result,
    legend_labels,
    long_drive,
    texts,
    without_detector,
    without_truth,
)


def cells_of(image: Any) -> np.ndarray:
    """The probabilities of a strip as they are drawn, NaN where it is blank."""
    return np.ma.filled(image.get_array(), np.nan)


def test_strip_cells_are_the_posterior_and_blank_where_no_frame_was_recorded() -> None:
    cells = strip_cells(a_result().frames, 100, 107)
    present = np.array(IDS) - 100
    np.testing.assert_array_equal(cells["Model"][present], MODEL)
    np.testing.assert_array_equal(cells["Detector"][present], DETECTOR)
    assert np.isnan(cells["Model"][4]).all()
    truth = cells["Truth"]
    np.testing.assert_array_equal(truth[[0, 1, 5, 6]], np.repeat(np.eye(3)[:2], 2, axis=0))
    assert np.isnan(truth[[4, 7]]).all()
    assert np.flatnonzero(cells["crossing"][:, 0] == 1).tolist() == [2, 3]
    assert np.flatnonzero(cells["wrong Model"][:, 0] == 1).tolist() == [6]
    assert np.flatnonzero(cells["wrong Detector"][:, 0] == 1).tolist() == [1, 6]
    assert np.flatnonzero(cells["unassigned Detector"][:, 0] == 1).tolist() == [0]


def test_the_figure_shows_model_detector_changes_and_truth_with_lane_1_as_the_top_row() -> None:
    figure = result_strips(a_result(), 100, 106)
    [ax] = figure.axes
    below, above = ax.get_ylim()
    assert below > above, "the y axis points down, so row 1 is at the top"
    assert {"Model", "Detector", "Changes", "Truth"} <= set(texts(figure))
    assert [t.get_text() for t in ax.get_yticklabels()] == ["1 (left)", "2", "3"] * 3
    shown = [cells_of(image) for image in ax.images]
    cells = strip_cells(a_result().frames, 100, 106)
    for image, name in zip(shown, ("Model", "Detector", "Truth"), strict=True):
        np.testing.assert_array_equal(image, cells[name].T)
    assert "tiny (in-sample): frames 100 to 106" in texts(figure)
    at = {t.get_text(): x for t, x in zip(ax.get_xticklabels(), ax.get_xticks(), strict=True)}
    assert at["102\n0:10.2"] == 102


def test_without_truth_or_detector_their_strips_are_left_out() -> None:
    assert "Truth" not in texts(result_strips(without_truth()))
    assert "wrong" not in legend_labels(result_strips(without_truth()).legends[0])
    assert "Detector" not in texts(result_strips(without_detector()))


def test_a_range_is_cut_to_the_result_and_refused_without_frames() -> None:
    for first, last in ((0, 99), (106, 101), (104, 104)):
        with pytest.raises(InputError, match=rf"{first} to {last}.* the result has 100 to 107"):
            result_strips(a_result(), first, last)
    assert list(frames_between(a_result().frames, 0, 10**9).index) == IDS
    assert list(frames_between(a_result().frames, None, 105).index[[0, -1]]) == [100, 105]


def test_a_long_range_continues_in_further_rows() -> None:
    figure = result_strips(long_drive(3000))
    assert [cells_of(ax.images[0]).shape for ax in figure.axes] == [(3, 1000)] * 3


def test_drives_with_the_same_frame_ids_are_drawn_one_after_the_other() -> None:
    frames = pd.concat([a_result().frames.assign(drive=name) for name in "ab"])
    figure = result_strips(a_result(frames=frames))
    assert "tiny (in-sample): frames 0 to 13" in texts(figure)
    cells = cells_of(figure.axes[0].images[0])
    np.testing.assert_array_equal(cells, np.tile(np.array(MODEL).T, 2))
