"""The drawing of a calibration on a still."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.vision.calibration.drawing import draw_view
from egolane_pgm.vision.calibration.road_lines import find_in_stills
from egolane_pgm.vision.calibration.straight_road import view_from
from egolane_pgm.vision.camera.model import image_to_road
from tests.kits.calibration_kit import TRUE, unturned


def test_the_drawing_lays_its_lanes_over_the_lines(stills: Path) -> None:
    path = sorted(stills.iterdir())[1]
    found = find_in_stills(unturned(TRUE), [path])
    view = view_from(unturned(TRUE), found.ahead, found.each, found.fits, 3.7, "stills")
    before = cv2.imread(str(path))
    drawn = draw_view(before, view, [])
    assert (before == cv2.imread(str(path))).all()
    orange = (drawn == (0, 159, 230)).all(axis=-1)
    near = np.argwhere(orange)[:, ::-1]
    y = image_to_road(TRUE, *near.T.astype(float))[1]
    # Without lines the lanes start half a lane to the left.
    off = np.abs((y[np.isfinite(y)] + 1.85 + 1.85) % 3.7 - 1.85)
    assert np.median(off) < 0.15
