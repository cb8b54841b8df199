"""What stands still in every picture is told from lines of the road."""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.vision.calibration.standing_still import LEAST_PICTURES, edge_counter
from egolane_pgm.vision.camera.model import vanishing_point
from tests.kits.synthetic_road import CAMERA, THREE, road


def moving_of(n_pictures: int) -> np.ndarray:
    """A drive with a watermark, and two lines of three that are continuous and stay where they
    are."""
    add, moving = edge_counter(CAMERA.width, CAMERA.height)
    for k in range(n_pictures):
        image = road(THREE, 2.7 * k, seed=k)
        cv2.putText(image, "12:30", (200, 255), 0, 0.8, (255, 255, 255), 2)
        add(image)
    every = np.ones((CAMERA.height, CAMERA.width), dtype=bool)
    return moving(np.array(vanishing_point(CAMERA)), every)


def test_a_watermark_stands_still_and_continuous_lines_do_not() -> None:
    moving = moving_of(LEAST_PICTURES)
    assert not moving[235:258, 205:260].any()
    moving[220:270, 185:290] = True
    assert moving.all()


def test_a_few_pictures_say_nothing() -> None:
    assert moving_of(LEAST_PICTURES - 1).all()
