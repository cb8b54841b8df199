"""The strips show the beliefs of the right frames in the right rows."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection

from egolane_pgm.types import InputError
from egolane_pgm.views import strips
from egolane_pgm.views.strips import (
    blank_reasons,
    frame_range,
    strip_columns,
    strips_figure,
)
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


class Strip(NamedTuple):
    """A strip as it is drawn: its name, its cells (n, C), and its place in inches."""

    name: str
    cells: Any
    left: float
    right: float
    top: float
    bottom: float


def strips_of(figure: Any) -> list[Strip]:
    """The strips of a figure from above, out of the one image of their cells."""
    (sheet,) = axes_called(figure, "strips")
    [image] = sheet.images
    x, y, cells = image._Ax, image._Ay, image.get_array().filled(np.nan)
    names = [text.get_text().replace("\n", " ") for text in sheet.texts if text.get_rotation()]
    n = (len(cells) + 1) // len(names)
    return [
        Strip(name, cells[k * n : (k + 1) * n - 1], x[0], x[-1], y[k * n], y[(k + 1) * n - 1])
        for k, name in enumerate(names)
    ]


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
    figure = strips_figure(a_result())
    (sheet,) = axes_called(figure, "strips")
    (grey,) = [c.get_paths() for c in sheet.collections if c.get_label() == "crossings"]
    truth = strips_of(figure)[-1]
    frame = (truth.right - truth.left) / 8
    np.testing.assert_allclose(grey[0].vertices.min(axis=0), [truth.left + 2 * frame, truth.top])
    np.testing.assert_allclose(grey[0].vertices.max(axis=0), [truth.left + 4 * frame, truth.bottom])


def test_the_figure_shows_model_above_detector_above_truth_with_lane_1_as_the_top_row() -> None:
    figure = strips_figure(a_result(), 100, 106)
    shown = strips_of(figure)
    assert [strip.name for strip in shown] == ["Model", "Detector only", "Ground truth"]
    (sheet,) = axes_called(figure, "strips")
    below, above = sheet.get_ylim()
    assert below > above, "the y axis points down, so row 1 is at the top"
    edges = [y for strip in shown for y in (strip.top, strip.bottom)]
    assert edges == sorted(edges)
    drawn = strip_columns(a_result(), 100, 106)
    for strip, image in zip(shown, drawn.images.values(), strict=True):
        named = [t for t in sheet.texts if strip.top < t.get_position()[1] < strip.bottom]
        assert [t.get_text() for t in named if t.get_text().startswith("lane")] == LANES
        np.testing.assert_array_equal(strip.cells, image)
    assert {"frame id", "time [s]"} <= set(texts(figure))
    assert "tiny (in-sample): frames 100 to 106" in texts(figure)


def test_time_runs_below_the_strips_in_seconds_and_frame_ids_above() -> None:
    figure = strips_figure(a_result())
    (sheet,) = axes_called(figure, "strips")
    model, *_, truth = strips_of(figure)
    at = {t.get_text(): t.get_position() for t in sheet.texts}
    middle_of_102 = model.left + 2.5 * (model.right - model.left) / 8
    assert at["102"][0] == pytest.approx(at["10.2"][0]) == pytest.approx(middle_of_102)
    assert at["102"][1] < model.top < truth.bottom < at["10.2"][1]
    assert {"100", "107", "10", "10.7"} <= set(at), "the first and the last frame are numbered"


def test_without_ground_truth_there_are_two_strips_and_no_grey() -> None:
    figure = strips_figure(without_truth())
    assert [s.name for s in strips_of(figure)] == ["Model", "Detector only"]
    assert strip_columns(without_truth(), 100, 107).truth is None
    assert legend_labels(figure.legends[0]) == ["no frame recorded"]


def test_without_a_tentative_vector_the_detector_strip_is_left_out() -> None:
    figure = strips_figure(without_tentative())
    assert [s.name for s in strips_of(figure)] == ["Model", "Ground truth"]


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
    rows = [strip for strip in strips_of(figure) if strip.name == "Model"]
    assert [row.cells.shape for row in rows] == [(3, 1000)] * 3
    (sheet,) = axes_called(figure, "strips")
    lines = [c for c in sheet.collections if isinstance(c, LineCollection)]
    outlines = [line for c in lines for line in c.get_segments() if len(line) == 5]
    np.testing.assert_allclose([np.ptp(line[:, 0]) for line in outlines], 7.3)
    edges = [y for strip in strips_of(figure) for y in (strip.top, strip.bottom)]
    assert edges == sorted(edges)


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
