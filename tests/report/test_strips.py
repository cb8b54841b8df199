"""The strips show the beliefs of the right frames in the right rows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.report import strips
from egolane_pgm.report.strips import (
    blank_reasons,
    frame_range,
    split_range,
    strip_columns,
    strips_figure,
)
from egolane_pgm.types import InputError
from tests.kits.tiny_result import (
    DETECTOR,
    IDS,
    MODEL,
    TRUTH,
    a_result,
    axes_called,
    legend_labels,
    long_drive,
    texts,
    without_tentative,
    without_truth,
)

LANES = ["lane 1 (leftmost)", "lane 2", "lane 3"]


def test_strip_columns_are_the_marginals_with_lane_1_on_top_and_gaps_blank() -> None:
    drawn = strip_columns(a_result(), 100, 107)
    present = np.array(IDS) - 100
    assert list(drawn.beliefs) == ["Model", "Detector only"]
    np.testing.assert_array_equal(drawn.beliefs["Model"][:, present], np.array(MODEL).T)
    np.testing.assert_array_equal(drawn.beliefs["Detector only"][:, present], np.array(DETECTOR).T)
    assert np.isnan(drawn.beliefs["Model"][:, 4]).all()


def test_the_truth_strip_is_one_in_the_true_lane_and_blank_where_nothing_is_annotated() -> None:
    truth = strip_columns(a_result(), 100, 107).truth
    assert truth is not None
    np.testing.assert_array_equal(truth[:, [0, 1]], [[1, 1], [0, 0], [0, 0]])
    np.testing.assert_array_equal(truth[:, [5, 6]], [[0, 0], [1, 1], [0, 0]])
    assert np.isnan(truth[:, [2, 3, 4, 7]]).all()


def test_crossings_are_grey_from_their_first_frame_to_their_last() -> None:
    assert strip_columns(a_result(), 100, 107).crossings == [(102, 104)]
    (ax,) = axes_called(strips_figure(a_result()), "Ground truth")
    (grey,) = [p for p in ax.patches if p.get_hatch() is None]
    assert (grey.get_x(), grey.get_width()) == (101.5, 2)
    assert (grey.get_y(), grey.get_height()) == (0.5, 3)


def test_the_figure_shows_model_above_detector_above_truth_with_lane_1_as_the_top_row() -> None:
    figure = strips_figure(a_result(), 100, 106)
    order = ["Model", "Detector only", "Ground truth"]
    axes = [axes_called(figure, name)[0] for name in order]
    heights = [ax.get_position().y0 for ax in axes]
    assert heights == sorted(heights, reverse=True)
    for ax in axes:
        assert [t.get_text() for t in ax.get_yticklabels()] == LANES
        below, above = ax.get_ylim()
        assert below > above, "the y axis points down, so row 1 is at the top"
        assert ax.images[0].get_extent() == [99.5, 106.5, 3.5, 0.5]
    drawn = strip_columns(a_result(), 100, 106)
    for ax, image in zip(axes, [*drawn.beliefs.values(), drawn.truth], strict=True):
        np.testing.assert_array_equal(ax.images[0].get_array().filled(np.nan), image)
    assert {"frame id", "time [s]"} <= set(texts(figure))
    assert "tiny (in-sample): frames 100 to 106" in texts(figure)


def test_time_runs_below_the_strips_in_seconds_and_frame_ids_above() -> None:
    (ax,) = axes_called(strips_figure(a_result()), "Ground truth")
    (seconds,) = ax.child_axes
    ax.figure.canvas.draw()
    np.testing.assert_allclose(seconds.get_xlim(), (9.95, 10.75))


def test_more_probable_lanes_are_drawn_darker() -> None:
    image = axes_called(strips_figure(a_result()), "Model")[0].images[0]
    grey = image.cmap(np.linspace(0, 1, 21))[:, :3] @ [0.299, 0.587, 0.114]
    assert (np.diff(grey) < 0).all()
    assert image.get_clim() == (0, 1)


def test_without_ground_truth_there_are_two_strips_and_no_grey() -> None:
    figure = strips_figure(without_truth())
    assert [ax.get_label() for ax in figure.axes] == ["Model", "Detector only", "colour bar"]
    assert strip_columns(without_truth(), 100, 107).truth is None
    assert legend_labels(figure.legends[0]) == ["no frame recorded"]


def test_without_a_tentative_vector_the_detector_strip_is_left_out() -> None:
    figure = strips_figure(without_tentative())
    assert [ax.get_label() for ax in figure.axes] == ["Model", "Ground truth", "colour bar"]


def test_the_legend_says_why_a_strip_is_blank() -> None:
    assert blank_reasons(a_result(), 100, 103) == []
    assert blank_reasons(a_result(), 100, 106) == ["no frame recorded"]
    assert blank_reasons(a_result(), 105, 107) == ["not annotated"]


@pytest.mark.parametrize(("first", "last"), [(0, 99), (108, 200), (106, 101), (104, 104)])
def test_a_range_without_frames_is_refused_with_the_range_of_the_recording(
    first: int, last: int
) -> None:
    with pytest.raises(InputError, match=r"has no frames; the recording has frame ids 100 to 107"):
        strips_figure(a_result(), first, last)


def test_a_range_that_reaches_beyond_the_recording_is_cut_to_it() -> None:
    assert frame_range(a_result(), 0, 10**9) == (100, 107)
    assert frame_range(a_result(), None, 105) == (100, 105)


def test_a_long_range_goes_on_in_further_rows_of_the_same_scale() -> None:
    figure = strips_figure(long_drive(3000))
    rows = [ax.images[0].get_extent()[:2] for ax in axes_called(figure, "Model")]
    assert rows == [[4.5, 1004.5], [1004.5, 2004.5], [2004.5, 3004.5]]
    boxes = [ax.get_position() for ax in figure.axes]
    assert len({round(box.width, 6) for box in boxes[:-1]}) == 1
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[i + 1 :])


def test_beyond_the_last_row_columns_are_means_over_frames_and_the_title_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = strip_columns(long_drive(400), 5, 404, max_columns=100)
    assert drawn.frames_per_column == 4
    np.testing.assert_allclose(drawn.beliefs["Model"], np.tile([[0.2], [0.6], [0.2]], 100))
    monkeypatch.setattr(strips, "MAX_ROWS", 1)
    title = texts(strips_figure(long_drive(strips.MAX_COLUMNS * 2)))[0]
    assert "each column is the mean of up to 2 frames" in title


def test_a_crossing_of_one_frame_is_not_averaged_away() -> None:
    drive = long_drive(400)
    drive.is_crossing[200] = True
    assert strip_columns(drive, 5, 404, max_columns=40).crossings == [(205, 215)]


@given(first=st.integers(0, 10**6), span=st.integers(1, 10**5), columns=st.integers(1, 2000))
def test_rows_cover_a_range_without_gap_or_overlap(first: int, span: int, columns: int) -> None:
    rows = split_range(first, first + span - 1, columns)
    assert rows[0][0] == first
    assert rows[-1][1] == first + span - 1
    assert all(b[0] == a[1] + 1 for a, b in pairwise(rows))
    assert len(rows) <= strips.MAX_ROWS
    lengths = [b - a + 1 for a, b in rows]
    assert max(lengths) - min(lengths) <= 1


@given(ids=st.sets(st.integers(0, 10**12), min_size=1, max_size=7), columns=st.integers(1, 50))
def test_every_frame_falls_into_the_column_of_its_id(ids: set[int], columns: int) -> None:
    frame_id = np.array(sorted(ids))
    n = len(frame_id)
    some = a_result(
        frame_id=frame_id,
        marginals={"Lane": np.array(MODEL)[:n]},
        tentative=None,
        true_lane=np.array(TRUTH)[:n],
        is_crossing=np.zeros(n, dtype=bool),
    )
    drawn = strip_columns(some, int(frame_id[0]), int(frame_id[-1]), columns)
    filled = ~np.isnan(drawn.beliefs["Model"][0])
    holds = [((frame_id >= a) & (frame_id < b)).any() for a, b in pairwise(drawn.edge)]
    np.testing.assert_array_equal(filled, holds)
