"""A study is data: what it names is compared, and never executed."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from tests.kits.drives import command, refused, write_drive

EVIL = "from pathlib import Path\nPath(__file__).with_name('executed').touch()\n"


def name_instead(study: Path, names: dict[str, str]) -> None:
    """Replace words that are in quotation marks in a journal or a database."""
    pairs = {f'"{old}"': f'"{new}"' for old, new in names.items()}
    if study.suffix == ".journal":
        text = study.read_text()
        assert all(old in text for old in pairs)
        for old, new in pairs.items():
            text = text.replace(old, new)
        study.write_text(text)
        return
    with sqlite3.connect(study) as database:
        for old, new in pairs.items():
            changed = database.execute(
                "UPDATE study_user_attributes SET value_json = replace(value_json, ?, ?)"
                " WHERE instr(value_json, ?)",
                (old, new, old),
            )
            assert changed.rowcount
    database.close()


@pytest.mark.parametrize("kept_in", ["journal", "database"])
def test_no_path_that_a_study_names_is_imported(tmp_path: Path, kept_in: str) -> None:
    evil = tmp_path / "evil.py"
    evil.write_text(EVIL)
    out = tmp_path / "out"
    words = ["tune", write_drive(tmp_path), "--in-sample-only", "--sampler", "random", "--out", out]
    database = tmp_path / "study.db"
    words += ["--storage", f"sqlite:///{database}"] if kept_in == "database" else []
    assert command(*words, "--trials", 2).exit_code == 0
    [directory] = out.iterdir()
    study = database if kept_in == "database" else directory / "study.journal"
    name_instead(study, dict.fromkeys(("counting", "sensor_failure", "random"), str(evil)))
    said = refused(*words, "--trials", 3)
    assert "holds another study" in said
    assert str(evil) in said
    command("plot", directory)
    assert not (tmp_path / "executed").exists()
