"""Figures show the numbers of the result; no pixels are compared."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.result import lanes_of
from egolane_pgm.scoring.confusion import scores_from_confusion
from egolane_pgm.scoring.scores import Answers, calibration_curve
from egolane_pgm.types import InputError
from egolane_pgm.views.comparisons import comparison_figure
from egolane_pgm.views.figures import (
    confusion_figure,
    confusions,
    dispersion,
    dispersion_figure,
    reliability_figure,
)
from egolane_pgm.views.strips import result_strips
from egolane_pgm.views.style import DETECTOR_COLOUR, MODEL_COLOUR, write_figure
from egolane_pgm.views.tables import percent
from tests.kits.tiny_result import (
    DETECTOR,
    EXPERIMENT,
    IDS,
    MODEL,
    RUN,
    TRUTH,
    a_result,
    frames_of,
    legend_labels,
    long_drive,
    without_detector,
    without_truth,
)


def test_dispersion_counts_correct_off_by_k_and_unassigned() -> None:
    matrix = np.array([[5, 1, 2], [3, 6, 4], [7, 8, 9], [10, 20, 30]])
    counts = {"correct": 20, "off by 1": 1 + 3 + 4 + 8, "off by 2": 2 + 7, "unassigned": 60}
    assert dispersion(matrix) == counts


def test_bars_are_the_shares_of_annotated_frames_that_are_not_crossing() -> None:
    results = [("tiny", each.frames) for each in (a_result(), without_detector())]
    [ax] = dispersion_figure(results).axes
    # Scored are 100, 101, 105, 106, truth 1, 1, 2, 2; detector -, 3, 2, 1; model 1, 1, 2, 3.
    counts = [[1, 1, 1, 1], [3, 1, 0, 0], [3, 1, 0, 0]]
    widths = [[4 * bar.get_width() for bar in container] for container in ax.containers]
    assert np.transpose(widths).tolist() == counts
    model = "tiny: Model\n3 lanes, 4 frames"
    assert [t.get_text() for t in ax.get_yticklabels()] == ["tiny: Detector", model, model]


def test_heat_map_texts_are_the_counts_and_the_column_percentages() -> None:
    figure = confusion_figure(a_result().frames, "tiny (in-sample)")
    assert figure.get_suptitle() == "tiny (in-sample): 4 frames"
    for ax, (name, matrix) in zip(figure.axes, confusions(a_result().frames).items(), strict=False):
        accuracy = 100 * float(scores_from_confusion(matrix)["accuracy"])
        assert ax.get_title() == f"{name}: {accuracy:.1f} % correct"
        drawn = [t.get_text() for t in ax.texts]
        assert [int(t) for t in drawn[1::2]] == matrix.ravel().tolist()
        shares = [float("nan") if t == "-" else float(t[:-2]) / 100 for t in drawn[::2]]
        np.testing.assert_allclose(shares, (matrix / [2, 2, np.nan]).ravel(), atol=0.0005)
        places = [t.get_position() for t in ax.texts[1::2]]
        assert [(round(y), round(x)) for x, y in places] == list(np.ndindex(4, 3))
    ticks = [t.get_text() for t in figure.axes[1].get_xticklabels()]
    assert ticks == ["lane 1\n2", "lane 2\n2", "lane 3\n0"]
    assert list(confusions(without_detector().frames)) == ["Model"]


def test_the_calibration_curve_passes_through_the_points_of_the_bins() -> None:
    frames = long_drive(60).frames
    upper, lower = reliability_figure(frames).axes
    for colour, bars in zip((DETECTOR_COLOUR, MODEL_COLOUR), lower.containers, strict=True):
        lane = np.full(60, 2)
        curve = calibration_curve(Answers(lanes_of(frames), lane, lane < 0, lane))
        line = next(x for x in upper.lines if x.get_color() == colour)
        filled = curve["count"] > 0
        np.testing.assert_array_equal(line.get_xdata(), curve["confidence"][filled])
        np.testing.assert_array_equal(line.get_ydata(), curve["accuracy"][filled])
        assert [bar.get_height() for bar in bars] == curve["count"].tolist()
    # Maxima 0.9, 0.7, 0.8, 0.6 in separate bins, the last one wrong.
    labels = legend_labels(reliability_figure(a_result().frames).legends[0])
    assert f"Model, ECE {(0.1 + 0.3 + 0.2 + 0.6) / 4:.3f}" in labels


@pytest.mark.parametrize("draw", [confusion_figure, reliability_figure])
def test_scores_cannot_be_drawn_without_ground_truth(draw: Any) -> None:
    crossing = frames_of(IDS, MODEL, DETECTOR, TRUTH, [True] * len(IDS))
    for frames in (without_truth().frames, crossing):
        with pytest.raises(InputError, match="no annotated frame that is not crossing"):
            draw(frames)


def test_a_comparison_is_drawn_with_hollow_in_sample_rows() -> None:
    columns = {"accuracy": [0.9, 0.99, 0.5], "accuracy_low": [0.8, None, 0.4]}
    columns |= {"accuracy_high": [0.95, None, 0.6], "tuned_on": ["not_tuned", "same_frames", ""]}
    table = pd.DataFrame(columns, index=pd.Index(["a", "b", "detector"], name="graph"))
    figure = comparison_figure(table)
    [ax] = figure.axes
    assert [t.get_text() for t in ax.get_yticklabels()] == ["a", "b", "detector"]
    filled, hollow = (np.asarray(line.get_xdata()).tolist() for line in ax.lines[:2])
    assert (filled, hollow) == ([0.9, 0.5], [0.99])
    table = pd.concat({"x": table, "y": table}, names=["tag.driver"])
    assert "y, detector" in [
        t.get_text() for t in comparison_figure(table).axes[0].get_yticklabels()
    ]


@pytest.mark.parametrize(
    ("draw", "extension", "magic"),
    [
        (result_strips, "png", b"\x89PNG"),
        (lambda r: confusion_figure(r.frames), "svg", b"<?xml"),
        (lambda r: reliability_figure(r.frames, "a"), "pdf", b"%PDF"),
        (lambda r: dispersion_figure([("a", r.frames)]), "svg", b"<?xml"),
    ],
)
def test_a_figure_is_one_whole_file_and_the_same_bytes_every_time(
    draw: Any, extension: str, magic: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # Importing it would now fail.
    path = tmp_path / "new" / f"figure.{extension}"
    assert write_figure(lambda: draw(a_result()), path) == path
    content = path.read_bytes()
    assert content.startswith(magic)
    write_figure(lambda: draw(a_result()), path)
    assert path.read_bytes() == content
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_an_extension_that_cannot_be_drawn_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"figure.jpg: .* ends in .png, .svg, .pdf"):
        write_figure(lambda: confusion_figure(without_truth().frames), tmp_path / "figure.jpg")


@given(share=st.floats(0, 1))
def test_a_percentage_never_hides_that_something_is_there(share: float) -> None:
    text = percent(share)
    assert (text == "0") == (share == 0)
    assert (text == "100") == (share == 1)


def test_one_lane_can_be_drawn(tmp_path: Path) -> None:
    ones = np.ones((7, 1))
    frames = frames_of(IDS, ones, ones, [1] * 7, [False] * 7)
    name = {"name": "two $\\frac$ dollars"}
    run = {**RUN, "n_lanes": 1, "values": {"Lane": ["1"]}}
    one = a_result(frames=frames, run=run, experiment=EXPERIMENT.model_copy(update=name))
    assert confusions(frames)["Model"].tolist() == [[7], [0]]
    title = str(name["name"])
    makes = {
        make.__name__: partial(make, frames, title)
        for make in (confusion_figure, reliability_figure)
    }
    for key, make in {"strips": partial(result_strips, one), **makes}.items():
        assert write_figure(make, tmp_path / f"{key}.png").stat().st_size > 5000
