"""The stereo detectors with the matcher ELAS, which only some have installed."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.detectors.runner import detect, find_detector, start
from tests.kits.synthetic_road import CAMERA, PAIR, drive

SEEN = replace(CAMERA, baseline_m=PAIR.baseline_m)


def test_a_drive_is_followed_with_the_plane_that_elas_shows() -> None:
    pytest.importorskip("elas", reason="ELAS: needs pyelas (the extra elas)")
    pictures = drive(14, stereo=True)
    lines = {}
    for matcher in ("sgbm", "elas"):
        detector = find_detector("sl", {"matcher": matcher, "match_rows": 1}, "detector")
        *_, (_, lines[matcher]) = detect(detector, SEEN, pictures)
    assert lines["elas"].is_valid.all()
    np.testing.assert_allclose(lines["elas"].offset_m, lines["sgbm"].offset_m, atol=0.1)


def test_if_elas_is_missing_the_message_has_the_command_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "elas", None)
    detector = find_detector("sc", {"matcher": "elas", "match_rows": 1}, "detector")
    with pytest.raises(InputError, match=r"matcher: elas is not installed: .*\[elas\]'$"):
        start(detector, SEEN)
    flat = find_detector("sc", {"matcher": "elas", "match_rows": 6}, "detector")
    with pytest.raises(InputError, match=r"match_rows: 6 leaves .*, and elas needs 64x48"):
        start(flat, SEEN)
    with pytest.raises(InputError, match=r"matcher: 'sgmb' is not one of sgbm, elas"):
        find_detector("sc", {"matcher": "sgmb"}, "detector")
