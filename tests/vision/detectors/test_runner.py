"""Detectors with parameters at the ends of their ranges, and users' detectors that break the
contract: they give lines, or one line of text that says what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.detectors import FrameLines
from tests.kits.drives import refused

GOOD: dict[str, Any] = {
    "shape": np.zeros((1, 4)),
    "is_valid": np.ones(1, dtype=bool),
    "is_continuous": np.ones(1, dtype=bool),
    "lri": np.ones(1),
}

OWN = """
import numpy as np
from egolane_pgm.vision.detectors import FrameLines
STEREO = False
{more}
def start(camera, parameters):
    def step(picture):
        return FrameLines(np.zeros((1, 4)), np.ones(1, bool), np.ones(1, bool), np.array([{lri}]))
    return step
"""


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("shape", np.zeros((1, 3)), r"shape needs a NumPy array of numbers, \(1, 4\)"),
        ("is_valid", np.array([0.5]), "is_valid needs a NumPy array of True or False"),
        ("lri", np.array([1, 2]), r"lri needs a NumPy array of numbers, \(1,\)"),
        ("lri", np.array([np.nan]), "lri is not finite"),
        ("lri", np.array([-1.0]), "a line's lri is not a count of detections"),
    ],
)
def test_lines_of_another_kind_are_refused(name: str, value: Any, expected: str) -> None:
    FrameLines(**GOOD)
    with pytest.raises(InputError, match=f"^lines: {expected}"):
        FrameLines(**{**GOOD, name: value})


@pytest.mark.parametrize(
    ("more", "lri", "expected"),
    [
        ("", "np.nan", "frame 0: lines: lri is not finite"),
        ("PARAMETERS = ({'contrast': 8},)", "1.0", "PARAMETERS: needs tuple[Parameter, ...], got"),
    ],
)
def test_an_own_detector_that_keeps_no_promise_is_named(
    place: Path, tmp_path: Path, more: str, lri: str, expected: str
) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN.format(more=more, lri=lri))
    target = tmp_path / "l.csv"
    words = ["detect", place / "drive.avi", "--camera", place / "cam.yaml"]
    message = refused(*words, "--detector", own, "-o", target)
    assert expected in message
    assert "own.py" in message
    assert not target.exists()
