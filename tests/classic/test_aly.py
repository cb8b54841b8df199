"""Aly's detector in single pictures of known roads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.classic import aly
from egolane_pgm.classic.aly import Found, line_finder, nearest
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors import FrameLines
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA as SMALL
from tests.kits.synthetic_road import Paint, drive, road

CAMERA = Camera(960, 540, 780.0, 780.0, 479.5, 269.5, height_m=1.4, pitch_deg=-4.0)
DEFAULTS = resolve_parameters(aly.PARAMETERS, {}, 1)
WIDTH = 3.66


def parallel(
    offset: float, heading: float = 0.0, curvature: float = 0.0, **more: Any
) -> list[Paint]:
    return [
        Paint(offset + k * WIDTH, heading=heading, curvature=curvature, **more) for k in (-1, 0, 1)
    ]


def found_in(image: Image) -> Found:
    return line_finder(CAMERA)(image)


def places(found: Found, x: float) -> np.ndarray:
    return found.shape @ np.array([1, x, x**2 / 2, x**3 / 6])


@needs_compiler
@settings(max_examples=8, deadline=None)
@given(
    st.floats(-3.2, -0.5),
    st.floats(-0.03, 0.03),
    st.floats(-0.001, 0.001),
    st.integers(0, 2**31),
)
def test_continuous_lines_are_found(
    offset: float, heading: float, curvature: float, seed: int
) -> None:
    found = found_in(road(parallel(offset, heading, curvature), camera=CAMERA, seed=seed))
    for x, tolerance in ((0, 0.25), (10, 0.08)):
        for k in (-1, 0, 1):
            true = offset + k * WIDTH + x * (heading + x * curvature / 2)
            assert np.abs(places(found, x) - true).min() < tolerance


def test_three_lines_are_found() -> None:
    found = found_in(road(parallel(-1.7), camera=CAMERA))
    for true in (-1.7 - WIDTH, -1.7, -1.7 + WIDTH):
        assert np.abs(places(found, 10) - true).min() < 0.15


def test_there_are_never_more_than_four_lines() -> None:
    many = [Paint(-7.5 + 2.5 * k) for k in range(7)]
    assert len(found_in(road(many, camera=CAMERA)).shape) == 4


def test_the_lines_that_are_kept_are_valid_and_near() -> None:
    offset = np.array([-6.0, -2.0, 1.0, 5.0, 8.0])
    shape = np.zeros((5, 4))
    shape[:, 0] = offset
    is_valid = np.array([True, False, True, True, True])
    four = nearest(FrameLines(shape, is_valid, ~is_valid, np.arange(5.0)), 4)
    assert four.offset_m.tolist() == [-6, 1, 5, 8]
    assert four.lri.tolist() == [0, 2, 3, 4]
    assert nearest(four, 2).offset_m.tolist() == [1, 5]


def test_a_picture_has_the_same_lines_whatever_came_before() -> None:
    pictures = [road(parallel(-1.7), k * 2.0, camera=CAMERA, seed=k) for k in range(3)]
    find = line_finder(CAMERA)
    forward = [find(image) for image in pictures]
    for image, before in zip(reversed(pictures), reversed(forward), strict=True):
        assert np.array_equal(find(image).shape, before.shape)


@pytest.mark.parametrize("grey", [0, 127, 255])
def test_no_lines_are_found_in_empty_pictures(grey: int) -> None:
    flat = np.full((CAMERA.height, CAMERA.width, 3), grey, dtype=np.uint8)
    assert len(found_in(flat).shape) == 0


def test_the_rim_of_a_blanked_part_is_not_a_line() -> None:
    image = road((), camera=CAMERA)
    image[:, : CAMERA.width // 2] = 0
    near = places(found_in(image), 10)
    assert (np.abs(near) > 0.5).all()


def test_a_drive_over_four_lanes_gives_four_lines_in_each_frame() -> None:
    step = aly.start(SMALL, {**DEFAULTS, "beyond_edge": "keep"})
    five = [Paint(3.2 * k) for k in (-2, -1, 0, 1, 2)]
    assert {len(step(picture).lri) for picture in drive(3, five)} == {4}
