"""What the simple detectors say of a whole drive, on synthetic roads."""

from __future__ import annotations

import pytest

from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import runner
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA, Paint, road


@needs_compiler
@pytest.mark.parametrize("gap_m", [0.1, 0.15, 0.2])
@pytest.mark.parametrize("name", ["ml", "mc"])
def test_a_double_line_is_one_continuous_line(name: str, gap_m: float) -> None:
    half = 0.12 / 2 + gap_m / 2
    double = tuple(Paint(-1.8 + side * half, width_m=0.12) for side in (-1, 1))
    pictures = [
        Picture(k, road((*double, Paint(1.9, 4.0, 12.0)), 2.7 * k, seed=k)) for k in range(16)
    ]
    detector = runner.find_detector(name, {}, "detector")
    *_, (_, last) = runner.detect(detector, CAMERA, pictures)
    assert last.offset_m[last.is_valid] == pytest.approx([-1.8, 1.9], abs=0.15)
    assert last.is_continuous[last.is_valid].tolist() == [True, False]
