"""What the simple detectors say of a whole drive, on synthetic roads."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, runner
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA, Paint, road

#: Dark patches in front of which the road is hidden: from and to, metres to the right.
VEHICLES = ((-5.4, -2.6), (-1.9, 0.9), (1.4, 4.2))


def detected(name: str, pictures: list[Picture]) -> tuple[list[FrameLines], list[str]]:
    """The lines of each picture, and what was warned of."""
    detector = runner.find_detector(name, {}, Path(), "detector")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        lines = [found for _, found in runner.detect(detector, CAMERA, pictures)]
    return lines, [str(one.message) for one in said]


def jammed(k: int) -> Picture:
    """A road on which a row of vehicles stands 9 m ahead."""
    image = road(seed=k)
    for left, right in VEHICLES:
        u, v = road_to_image(CAMERA, [9, 9, 30, 30], [left, right, right * 3, left * 3])
        cv2.fillConvexPoly(image, np.stack([u, v], 1).round().astype(int), (9, 9, 9))
    return Picture(k, image)


@needs_compiler
@pytest.mark.parametrize("name", ["ml", "mc"])
def test_a_road_that_is_mostly_hidden_for_ten_pictures_is_said_once(name: str) -> None:
    free = [Picture(k, road(seed=k)) for k in range(10)]
    assert not detected(name, [jammed(k) for k in range(9)])[1]
    (said,) = detected(name, [*free, *(jammed(k) for k in range(10, 24))])[1]
    assert said.startswith("frame 19: vehicles have seemed to hide most of the road for 10 frames")


@needs_compiler
@pytest.mark.parametrize("gap_m", [0.1, 0.15, 0.2])
@pytest.mark.parametrize("name", ["ml", "mc"])
def test_a_double_line_is_one_continuous_line(name: str, gap_m: float) -> None:
    half = 0.12 / 2 + gap_m / 2
    double = tuple(Paint(-1.8 + side * half, width_m=0.12) for side in (-1, 1))
    pictures = [
        Picture(k, road((*double, Paint(1.9, 4.0, 12.0)), 2.7 * k, seed=k)) for k in range(16)
    ]
    last = detected(name, pictures)[0][-1]
    assert last.offset_m[last.is_valid] == pytest.approx([-1.8, 1.9], abs=0.15)
    assert last.is_continuous[last.is_valid].tolist() == [True, False]
