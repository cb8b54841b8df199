"""The measure of Aly's paper on lines whose distances are known."""

from __future__ import annotations

import numpy as np
import pytest

from makers.camera.aly import is_right, paper_counts, stills
from makers.camera.tusimple import data_file

LABEL = np.array([[100.0, 200.0], [100.0, 400.0]])


def beside(pixels: float) -> np.ndarray:
    return LABEL + np.array([pixels, 0])


def test_distances_decide_and_one_of_two_is_easier_than_both() -> None:
    assert is_right(beside(14), LABEL, both=True)
    assert not is_right(beside(17), LABEL, both=True)
    assert is_right(beside(17), LABEL, both=False)
    assert not is_right(beside(21), LABEL, both=False)


def test_a_short_line_on_a_long_label_is_right_and_so_is_a_long_one_on_a_short() -> None:
    short = np.array([[103.0, 300.0], [103.0, 320.0]])
    assert is_right(short, LABEL, both=True)
    assert is_right(LABEL, short, both=True)


def test_a_label_is_found_once() -> None:
    counts = paper_counts([beside(3), beside(-4), beside(200)], [LABEL, beside(500)], both=True)
    assert counts.tolist() == [1, 3, 2]


def test_worn_lines_are_found_as_often_as_the_docstring_of_the_figures_says() -> None:
    labels = data_file()
    if labels is None:
        pytest.skip("camera/tusimple_frames: needs EGOLANE_DATA with it")
    found = stills(labels)
    # Reached: 69 %, 80 %.
    assert found.at_10_m[0] / found.at_10_m[1] > 0.64
    assert found.at_10_m[2] / found.at_10_m[3] > 0.74
