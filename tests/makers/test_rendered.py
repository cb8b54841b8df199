"""The scores in the figures of the rendered drives, on lines that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.vision.rendering.render import true_lines
from egolane_pgm.vision.rendering.scene import FAILURES, make_scene
from makers.camera.rendered import Seen, follow, lane_belief, score_lines


@pytest.fixture(scope="module")
def seen() -> Seen:
    scene = make_scene("a2", 5, 300, **dict.fromkeys(FAILURES, 0.0))
    offset = scene.road.line_offset_m
    return Seen(scene, offset, np.ones_like(offset), 0.0, {})


def test_the_true_lines_are_found_without_error(seen: Seen) -> None:
    lines = score_lines(seen, true_lines(seen.scene))
    assert (lines.error_m, lines.error_90_m) == (0, 0)
    assert (lines.recall, lines.false_share, lines.flag_right) == (1, 0, 1)


def test_missed_false_and_shifted_lines_are_counted(seen: Seen) -> None:
    log = true_lines(seen.scene)
    shifted = score_lines(seen, replace(log, offset_m=log.offset_m + 0.2))
    assert shifted.error_m == pytest.approx(0.2)
    valid = log.is_valid.copy()
    valid[::2] = False
    half = score_lines(seen, replace(log, is_valid=valid))
    assert half.recall == pytest.approx(0.5, abs=0.02)
    # Between two lines: near none.
    wrong = score_lines(seen, replace(log, offset_m=log.offset_m + 1.75))
    assert (wrong.recall, wrong.false_share) == (0, 1)
    assert np.isnan(wrong.error_m)


def test_lines_that_cannot_be_seen_are_not_wanted(seen: Seen) -> None:
    log = true_lines(seen.scene)
    valid = log.is_valid.copy()
    valid[:, 0] = False
    visible = np.ones_like(seen.visible)
    visible[:, 0] = 0.2
    lines = score_lines(replace(seen, visible=visible), replace(log, is_valid=valid))
    assert lines.recall == 1


@pytest.mark.parametrize("graph", ["sensor_failure", "position_in_lane"])
def test_the_true_lines_give_the_true_lane(seen: Seen, graph: str) -> None:
    run = lane_belief(seen, true_lines(seen.scene), graph)
    assert run.scores["model"]["accuracy"] > 0.97


def test_a_drive_is_followed_by_every_detector() -> None:
    names = ("ml", "mc")
    scene = make_scene("a4", 1, 15)
    seen = follow(scene, names)
    assert set(seen.detectors) == set(names)
    assert all(len(followed.log) == 15 for followed in seen.detectors.values())
    np.testing.assert_array_equal(seen.offset_m, scene.road.line_offset_m)
