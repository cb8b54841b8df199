"""Pictures full of thin bright streaks, as of rain, and of noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.fit import find_lines, view_for
from egolane_pgm.vision.detectors.simple.markings import NOISE, RAIN, streak_cover
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from tests.kits.synthetic_road import Paint, road
from tests.vision.detectors.simple.test_upright import CAMERA

DEFAULTS = resolve_parameters(FINDING, {}, 1)
#: A shape times this is where the line is 10 m ahead.
TEN_METRES = np.array([1, 10, 50, 1000 / 6])
LINES = (Paint(-1.75), Paint(1.9))


def rain(image: Image, streaks: int, seed: int = 0) -> Image:
    """The picture with slanted streaks of one pixel."""
    rng = np.random.default_rng(seed)
    image = image.copy()
    for _ in range(streaks):
        u, v = rng.integers(image.shape[1]), rng.integers(image.shape[0])
        long = rng.integers(15, 40)
        cv2.line(image, (int(u), int(v)), (int(u + long // 5), int(v + long)), (190, 190, 190), 1)
    return image


@pytest.mark.parametrize("noise", [0.0, 3.0])
@pytest.mark.parametrize("blank", [0, 255, None])
def test_a_road_without_rain_is_not_streaky(noise: float, blank: int | None) -> None:
    image = road(camera=CAMERA, noise=noise)
    assert streak_cover(image if blank is None else np.full_like(image, blank)) <= RAIN


def test_rain_is_streaky() -> None:
    assert RAIN < streak_cover(rain(road(camera=CAMERA), 900)) <= NOISE


@pytest.mark.parametrize("seed", range(3))
def test_lines_are_found_in_rain(seed: int) -> None:
    image = rain(road(LINES, camera=CAMERA, seed=seed), 900, seed)
    found = find_lines(view_for(CAMERA, DEFAULTS), image, DEFAULTS)
    for line in LINES:
        assert np.abs(found.shape[:, 0] - line.offset_m).min() < 0.15


@pytest.mark.parametrize("curve", ["line", "clothoid"])
@pytest.mark.parametrize("seed", range(3))
def test_lines_are_found_in_noise(curve: str, seed: int) -> None:
    parameters = {**DEFAULTS, "curve": curve}
    image = road(LINES, camera=CAMERA, noise=35, seed=seed)
    assert streak_cover(image) > NOISE
    found = find_lines(view_for(CAMERA, parameters), image, parameters)
    assert len(found.shape) <= len(LINES) + 2
    for line in LINES:
        assert np.abs(found.shape @ TEN_METRES - line.offset_m).min() < 0.15
