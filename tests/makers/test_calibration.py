"""The figure of how right beliefs are, by kind of detector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.scoring.probabilistic import N_BINS
from egolane_pgm.types import LaneTruth
from makers.benchmark.tracks import Recording
from makers.beyond.calibration import KINDS, figure, kind_of, reliability
from tests.evidence.line_geometry.test_rule import line_log


@pytest.mark.parametrize(
    ("track", "donor", "kind"),
    [
        ("paper", "spain_sl", "sl"),
        ("motion, 3 lanes", "italy_mld", "italy_mld"),
        ("two_lines, start told", "", "two_lines, start told"),
    ],
)
def test_every_drive_has_a_kind_of_detector(track: str, donor: str, kind: str) -> None:
    log = line_log([[-1.75, 1.75]])
    truth = LaneTruth(log.frame_id, np.array([2]), np.array([False]), "truth")
    drive = Recording("motion", "name", "d1", "drive", "", 3, log, truth)
    assert kind_of(replace(drive, track=track, donor=donor)) == kind
    assert kind in KINDS


def test_a_panel_shows_the_frames_of_all_drives_of_a_kind() -> None:
    count = np.arange(N_BINS) * 100.0
    drive = {"reliability": [count, count * 0.9, count * 0.8]}
    np.testing.assert_allclose(reliability([drive, drive]), 2 * np.array(drive["reliability"]))
    drawn = figure({kind: [drive, drive] for kind in KINDS})
    titles = [axes.get_title() for axes in drawn.axes if axes.get_title()]
    assert titles == [*KINDS.values()]
    answer, share = drawn.axes[0].lines[1].get_data()
    np.testing.assert_allclose(answer, 0.9)
    np.testing.assert_allclose(share, 0.8)
