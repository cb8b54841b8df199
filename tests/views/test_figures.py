"""Figures show the numbers of the result; no pixels are compared."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.results import Result
from egolane_pgm.scoring.confusion import accuracy
from egolane_pgm.types import InputError
from egolane_pgm.views.answers import DETECTOR_COLOUR, MODEL_COLOUR, percent
from egolane_pgm.views.dispersion import (
    bonus_ablation_figure,
    dispersion,
    dispersion_figure,
    dispersions,
)
from egolane_pgm.views.heatmaps import column_shares, confusion_figure, confusions
from egolane_pgm.views.reliability import reliabilities, reliability_figure
from egolane_pgm.views.strips import strips_figure
from egolane_pgm.views.style import write_figure
from tests.kits.tiny_result import (
    IDS,
    a_result,
    texts,
    without_bonus,
    without_tentative,
    without_truth,
)

# Error dispersion.


def test_dispersion_counts_right_off_by_k_and_unassigned() -> None:
    matrix = np.array([[5, 1, 2], [3, 6, 4], [7, 8, 9], [10, 20, 30]])
    np.testing.assert_array_equal(dispersion(matrix), [20, 1 + 3 + 4 + 8, 2 + 7, 60])


def test_bars_count_only_annotated_frames_that_are_not_crossing() -> None:
    bars = dispersions(a_result())
    # Scored are 100, 101, 105, 106, truth 1, 1, 2, 2: the detector says -, 3, 2, 1; the model
    # says 1, 1, 2, 3.
    assert list(bars) == ["Detector only", "Model"]
    np.testing.assert_array_equal(bars["Detector only"], [1, 1, 1, 1])
    np.testing.assert_array_equal(bars["Model"], [3, 1, 0, 0])


@pytest.fixture(scope="module")
def dispersion_sheet() -> Any:
    other = {**a_result().run, "name": "other", "tuned_on": "other_frames"}
    return dispersion_figure([a_result(), replace(without_tentative(), run=other)])


def test_bar_widths_are_the_counted_shares_and_sum_to_one(dispersion_sheet: Any) -> None:
    (ax,) = dispersion_sheet.axes
    bars = [*dispersions(a_result()).values(), *dispersions(without_tentative()).values()]
    rectangles = [p for container in ax.containers for p in container]
    assert len(rectangles) == 4 * len(bars)
    for k, bar in enumerate(bars):
        drawn = rectangles[4 * k : 4 * k + 4]
        widths = [p.get_width() for p in drawn]
        np.testing.assert_allclose(widths, bar / bar.sum())
        np.testing.assert_allclose([p.get_x() for p in drawn], np.cumsum([0, *widths[:-1]]))
        assert len({p.get_y() for p in drawn}) == 1


# The ablation.


def test_the_ablation_puts_with_and_without_bonus_side_by_side() -> None:
    unsure = without_bonus(assigned_lane=np.zeros(len(IDS), dtype=int))
    figure = bonus_ablation_figure(a_result(), unsure)
    (ax,) = figure.axes
    assert [t.get_text() for t in ax.get_yticklabels()] == ["BV = 4", "no BV"] * 2
    widths = np.array([p.get_width() for c in ax.containers for p in c]).reshape(4, 4)
    np.testing.assert_allclose(widths[2:], [[0.75, 0.25, 0, 0], [0, 0, 0, 1]])
    assert {"right without BV: +0.0 points", "right without BV: -75.0 points"} <= set(texts(figure))
    assert "tiny (in-sample)" in texts(figure)[0]
    assert texts(figure)[0].endswith("; all else the same")


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ((a_result(), without_bonus(frame_id=np.array(IDS) + 1)), "frame_id differs"),
        ((a_result(), without_bonus(true_lane=np.ones(7, dtype=int))), "true_lane differs"),
        (
            (a_result(), without_bonus(tentative=None)),
            "results/no_bonus: has no tentative vector",
        ),
    ],
)
def test_an_ablation_of_results_that_cannot_be_compared_is_refused(
    pair: tuple[Result, Result], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        bonus_ablation_figure(*pair)


# Confusion matrices.


def test_heat_map_texts_are_the_counts_and_the_column_percentages() -> None:
    figure = confusion_figure(a_result())
    assert "tiny (in-sample): 4 frames" in texts(figure)
    for ax, (name, matrix) in zip(figure.axes, confusions(a_result()).items(), strict=False):
        assert ax.get_title() == f"{name}: {100 * float(accuracy(matrix)):.1f} % right"
        drawn = [t.get_text() for t in ax.texts]
        assert [int(t) for t in drawn[1::2]] == matrix.ravel().tolist()
        shares = [float("nan") if t == "-" else float(t[:-2]) / 100 for t in drawn[::2]]
        np.testing.assert_allclose(shares, column_shares(matrix).ravel(), atol=0.0005)
        positions = [t.get_position() for t in ax.texts[1::2]]
        assert [(round(y), round(x)) for x, y in positions] == list(np.ndindex(4, 3))
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == [
        "lane 1",
        "lane 2",
        "lane 3",
        "Unassigned",
    ]
    assert [t.get_text() for t in figure.axes[1].get_xticklabels()] == [
        "lane 1\n2 frames",
        "lane 2\n2 frames",
        "lane 3\n0 frames",
    ]


def test_confusion_without_a_tentative_vector_draws_the_model_alone() -> None:
    figure = confusion_figure(without_tentative())
    assert [ax.get_title().split(":")[0] for ax in figure.axes] == ["Model", ""]


# Calibration.


def test_the_calibration_curve_passes_through_the_points_of_the_bins() -> None:
    upper, lower = reliability_figure(a_result()).axes
    found = reliabilities(a_result())
    colours = {"Detector only": DETECTOR_COLOUR, "Model": MODEL_COLOUR}
    for (name, (curve, _)), bars in zip(found.items(), lower.containers, strict=True):
        filled = curve.count > 0
        with_data = [
            x for x in upper.lines if x.get_color() == colours[name] and len(x.get_xdata())
        ]
        np.testing.assert_array_equal(with_data[0].get_xdata(), curve.confidence[filled])
        np.testing.assert_array_equal(with_data[0].get_ydata(), curve.accuracy[filled])
        assert [bar.get_height() for bar in bars] == curve.count.tolist()
    # Model: maxima 0.9, 0.7, 0.8, 0.6 in bins of their own, the last one wrong.
    assert found["Model"][1] == pytest.approx((0.1 + 0.3 + 0.2 + 0.6) / 4)


@pytest.mark.parametrize("draw", [confusion_figure, reliability_figure])
def test_scores_cannot_be_drawn_without_ground_truth(draw: Any) -> None:
    with pytest.raises(InputError, match="results/tiny: has no ground truth"):
        draw(without_truth())
    with pytest.raises(InputError, match="no annotated frame that is not crossing"):
        draw(a_result(is_crossing=np.ones(len(IDS), dtype=bool)))


# All of them.


@pytest.mark.parametrize(
    ("draw", "extension", "magic"),
    [
        (strips_figure, "png", b"\x89PNG"),
        (confusion_figure, "svg", b"<?xml"),
        (reliability_figure, "pdf", b"%PDF"),
        (lambda r: dispersion_figure([r]), "svg", b"<?xml"),
        (lambda r: bonus_ablation_figure(r, without_bonus()), "png", b"\x89PNG"),
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
    with pytest.raises(InputError, match=r"figure.jpg: a figure ends in .png, .svg, .pdf"):
        write_figure(lambda: confusion_figure(without_truth()), tmp_path / "figure.jpg")


@given(share=st.floats(0, 1))
def test_a_percentage_never_hides_that_something_is_there(share: float) -> None:
    text = percent(share)
    assert (text == "0") == (share == 0)
    assert (text == "100") == (share == 1)


def test_one_lane_can_be_drawn(tmp_path: Path) -> None:
    ones = np.ones((7, 1))
    one = a_result(
        run={**a_result().run, "n_lanes": 1, "name": "two $\\frac$ dollars"},
        marginals={"Lane": ones},
        tentative=ones,
        assigned_lane=np.ones(7, dtype=int),
        true_lane=np.ones(7, dtype=int),
    )
    assert [bar.tolist() for bar in dispersions(one).values()] == [[5, 0], [5, 0]]
    assert confusions(one)["Model"].tolist() == [[5], [0]]
    for make in (strips_figure, confusion_figure, reliability_figure):
        path = write_figure(partial(make, one), tmp_path / f"{make.__name__}.png")
        assert path.stat().st_size > 5000
