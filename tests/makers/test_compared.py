"""The table and the figure that compare all detectors, on a short drive and on made-up rows."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from makers.camera import compared
from makers.camera.compared import Row, draw_rows, rows_of, seen_by, table, verdict
from makers.camera.rendered import Lines

LINES = Lines(0.02, 0.05, 0.98, 0.001, 0.99)
MADE_UP = (
    Row("ml", (0.7, 0.6), (0.9, 0.8), LINES, 5.0),
    Row("mld", (0.4, 0.3), (0.3, 0.2), LINES, 50.0),
    Row("own", (0.5, 0.4), (0.8, 0.7), LINES, 8.0),
)


def test_a_drive_is_compared_detector_by_detector() -> None:
    (row,) = rows_of(seen_by(["ml"], frames=40))
    assert row.name == "ml"
    assert 0 < row.lines.error_m < 0.2
    assert row.lines.recall > 0.3
    assert row.ms > 0


def test_the_table_has_the_papers_figures_beside_ours() -> None:
    text = [" ".join(line.split()) for line in table(MADE_UP)]
    assert len(text) == 2 + len(MADE_UP)
    assert "| 0.55, 0.85 |" in text[2]
    assert "0.700 | 0.900 |" in text[2]
    assert "| - |" in text[4]
    assert text[3].endswith("50 ms |")


def test_two_sentences_say_what_agrees_and_what_does_not() -> None:
    said = verdict(MADE_UP)
    assert "2 of 3 detectors (not for mld), by -0.10 to 0.30" in said
    assert "in 0.40 to 0.70 of frames where the paper has 0.00 to 0.64" in said
    assert "for every detector" in verdict(MADE_UP[:1])


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    draw_rows(MADE_UP, tmp_path / "detectors.png")
    picture = cv2.imread(str(tmp_path / "detectors.png"))
    assert picture.shape[1] == pytest.approx(1500, abs=5)
    assert picture.std() > 10


def test_detectors_that_are_absent_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compared, "plugin_names", lambda kind: ["mc", "other"])
    asked = []
    monkeypatch.setattr(compared, "seen_by", lambda names, network: asked.append((names, network)))
    monkeypatch.setattr(compared, "rows_of", lambda seen: ())
    compared.compared.cache_clear()
    compared.compared()
    compared.compared.cache_clear()
    assert asked == [(["mc"], None)]
