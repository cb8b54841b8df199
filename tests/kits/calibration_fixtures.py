"""Drawn chessboards and stills of a road, for the tests of the calibration."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.kits.calibration_kit import TRUE, draw_board, draw_road


@pytest.fixture(scope="module")
def boards(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    rng = np.random.default_rng(3)
    for k in range(10):
        turn = rng.uniform(-0.5, 0.5, 3)
        place = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.04, 0.04), 0.42])
        cv2.imwrite(str(folder / f"{k}.png"), draw_board(TRUE, turn, place))
    return folder


@pytest.fixture(scope="module")
def stills(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("stills")
    for k, shift in enumerate((0.0, 0.3, -0.4)):
        offsets = np.array([-5.55, -1.85, 1.85, 5.55]) + shift
        cv2.imwrite(str(folder / f"{k}.png"), draw_road(TRUE, offsets, 0.004 * (k - 1), k))
    return folder
