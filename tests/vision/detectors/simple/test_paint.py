"""The painted share of a line, which tells a continuous line from a dashed one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import make_view
from egolane_pgm.vision.detectors.simple.paint import PARAMETERS, painted_share
from tests.kits.synthetic_road import CAMERA, Paint, road

VIEW = make_view(CAMERA, 4.5, 35.0, -9.0, 9.0, 0.1, 0.05)


def share(image: Image, *lines: Paint, **given: object) -> FloatArray:
    shape = np.array([[p.offset_m, p.heading, p.curvature, 0.0] for p in lines]).reshape(-1, 4)
    return painted_share(VIEW, image, shape, resolve_parameters(PARAMETERS, given, 1))


@pytest.mark.parametrize("offset", [-5.2, -1.7, 1.8, 4.0])
def test_a_continuous_line_is_painted_all_along(offset: float) -> None:
    line = Paint(offset)
    assert share(road([line]), line)[0] > 0.95


@pytest.mark.parametrize(("dash", "period"), [(3.0, 9.0), (4.5, 12.0), (5.0, 17.0)])
def test_a_dashed_line_is_painted_at_its_dashes(dash: float, period: float) -> None:
    """Averaged over a drive: the share is that of the dashes, seen a little too long."""
    line = Paint(1.8, dash, period)
    shares = [share(road([line], travelled), line)[0] for travelled in np.arange(0, period, 1.3)]
    assert np.mean(shares) == pytest.approx(dash / period, abs=0.08)
    assert max(shares) < 0.75


@pytest.mark.parametrize("width", [0.15, 0.3])
def test_block_marking_is_broken_wherever_its_gaps_are(width: float) -> None:
    line = Paint(1.8, 6.0, 9.0, width_m=width)
    shares = [share(road([line], travelled), line)[0] for travelled in np.arange(0, 9, 1.3)]
    assert np.median(shares) == max(shares[:2]) == 0.5


def test_a_yellow_line_is_as_bright_as_a_white_one() -> None:
    """On concrete its grey is that of the road."""
    line = Paint(-1.7, grey=255)
    image = road([line], noise=0).astype(np.int64) + 60
    is_paint = image[..., 0] > 255
    image[is_paint] = (60, 175, 250)  # blue, green, red; grey 184 on 155
    assert share(np.clip(image, 0, 255).astype(np.uint8), line)[0] > 0.95


@pytest.mark.parametrize("noise", [3.0, 12.0, 25.0])
def test_noise_is_not_paint(noise: float) -> None:
    line, dashed = Paint(1.8), Paint(1.8, 4.0, 12.0)
    # What noise looks like is all that is there, also where one line is expected.
    assert share(road([], noise=noise), line)[0] < 0.25
    assert share(road([dashed], 2.0, noise=noise), line)[0] < 0.6


def test_the_flag_is_unknown_if_too_little_is_in_view() -> None:
    line = Paint(1.8)
    assert np.isnan(share(road([line]), Paint(30.0)))[0]
    assert share(road([line])).shape == (0,)


def test_paint_half_a_metre_beside_a_line_is_not_its_own_and_does_not_hide_it() -> None:
    line, beside = Paint(1.8), Paint(2.3, grey=250)
    assert share(road([beside], noise=1), line)[0] < 0.1
    assert share(road([replace(line, grey=140), beside], noise=1), line)[0] > 0.95
