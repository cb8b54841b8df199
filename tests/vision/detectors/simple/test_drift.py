"""A camera that is no longer pitched as it was calibrated, on synthetic roads and real pictures."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, runner
from egolane_pgm.vision.detectors.simple import drift
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA, Paint, road

LINES = (Paint(-5.46), Paint(-1.8, 4.0, 12.0), Paint(1.86), Paint(5.52, 4.0, 12.0))


def turned(degrees: float, **more: Any) -> Camera:
    return replace(CAMERA, pitch_deg=CAMERA.pitch_deg + degrees, **more)


@cache
def pictures(n: int, pitching: float = 0.0) -> tuple[Picture, ...]:
    """Pictures of CAMERA, which pitches by so much to either side from picture to picture."""
    return tuple(
        Picture(k, road(LINES, 3.1 * k, camera=turned(pitching * (-1) ** k), seed=k))
        for k in range(n)
    )


def detected(
    camera: Camera, shown: Sequence[Picture], name: str = "ml", **parameters: Any
) -> tuple[list[FrameLines], list[str]]:
    """The lines of each picture and the warnings."""
    detector = runner.find_detector(name, parameters, "detector")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lines = [found for _, found in runner.detect(detector, camera, shown)]
    return lines, [str(one.message) for one in caught]


@needs_compiler
def test_a_drift_is_warned_of_once_and_names_camera_estimate_and_calibration() -> None:
    _, messages = detected(turned(1.0, name="front.yaml"), pictures(14))
    (line,) = messages
    estimate_deg, sd = re.search(
        r"of (-[\d.]+) degrees \(standard deviation ([\d.]+)\)", line
    ).groups()
    assert float(estimate_deg) == pytest.approx(CAMERA.pitch_deg, abs=float(sd))
    assert "front.yaml: the lines of the road show a pitch of" in line
    assert "calibrated with pitch_deg -3.00" in line
    assert line.endswith("the pitch is corrected from here on")


@needs_compiler
@pytest.mark.parametrize("name", ["ml", "mc"])
def test_a_car_that_pitches_by_a_third_of_a_degree_is_not_warned_of(name: str) -> None:
    _, messages = detected(CAMERA, pictures(20, pitching=0.3), name)
    assert not messages


@needs_compiler
@pytest.mark.parametrize("away", [-1.0, 1.0])
def test_the_pitch_is_corrected_and_lines_ahead_are_in_their_places(away: float) -> None:
    def places(choice: str) -> FloatArray:
        lines, messages = detected(
            turned(away), pictures(14), camera_drift=choice, beyond_edge="keep"
        )
        assert [line.endswith("corrected from here on") for line in messages] == (
            [True] if choice == "correct" else []
        )
        shape = lines[-1].shape[lines[-1].is_valid]
        found: FloatArray = shape[:, 0] + 20 * shape[:, 1]
        return found

    assert places("correct") == pytest.approx([line.offset_m for line in LINES], abs=0.2)
    # Twenty metres ahead a wrong pitch of a degree makes lanes a quarter wider or narrower.
    wrong = places("ignore")
    assert np.abs(wrong - 1.86).min() > 0.3


@needs_compiler
def test_the_lines_beside_the_car_stay_valid_while_the_pitch_is_corrected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drift, "_EVERY", 2)
    # The camera is hit after ten pictures.
    shown = list(pictures(14)[:10])
    for k in range(10, 40):
        image = road(LINES, 3.1 * k, camera=turned(-1.0), seed=k)
        shown.append(Picture(k, image))
    lines, messages = detected(CAMERA, shown, camera_drift="correct")
    (line,) = messages
    assert f"calibrated with pitch_deg {CAMERA.pitch_deg:.2f}" in line
    for found in lines[12:]:
        assert found.offset_m[found.is_valid][-2:] == pytest.approx([-1.8, 1.86], abs=0.5)
    last = lines[-1].shape
    assert last[:, 0] + 20 * last[:, 1] == pytest.approx([-5.46, -1.8, 1.86], abs=0.2)
