"""The command `egolane run`."""

from __future__ import annotations

from pathlib import Path

from tests.kits.drives import refused, write_drive


def test_an_experiments_options_cannot_stand_for_its_other_keys(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, 30, recording__options={"format": "table"})
    assert "format table has no option 'format'" in refused("run", experiment)
