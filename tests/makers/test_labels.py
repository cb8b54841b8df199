"""Labels of a whole drive as a perfect detector: its lane changes and its leftmost lane."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.vision.camera.model import write_camera
from makers.camera import labels
from tests.conftest import needs_compiler


def test_outcomes_count_changes_within_three_seconds_and_in_the_right_direction() -> None:
    changes = [(180, 240, -1), (540, 600, -1), (841, 900, -1), (7780, 7800, 1)]
    outcome = labels.Outcome(tuple(labels.Change(*c) for c in changes), (1, 1, 2, 1))
    assert outcome.late_s == {180: 0.0, 480: 3.0}
    assert (outcome.found, outcome.others, outcome.found_first) == (2, 2, 1)
    assert outcome.leftmost == 0.75


@needs_compiler
def test_the_nine_lane_changes_are_found_and_the_leftmost_lane_is_known(tmp_path: Path) -> None:
    path = labels.data_file()
    if path is None:
        pytest.skip(f"the labelled drive: needs EGOLANE_DATA with {labels.FILE}")
    write_camera(tmp_path / "camera.yaml", labels.CAMERA)
    outcome = labels.run_stretches(path, tmp_path / "camera.yaml")
    assert (outcome.found, outcome.found_first, outcome.others) == (9, 9, 0)
    assert len(outcome.yellow) > 120
    assert outcome.leftmost >= 0.95


def test_the_figures_say_so_where_the_labels_are_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    assert labels.measure() == [f"Labels of a drive: {labels.FILE} is absent (EGOLANE_DATA)."]
