"""SECURITY.md: what executes a program that a YAML names, and what does not."""

from __future__ import annotations

from pathlib import Path

import pytest

import egolane_pgm as ego
from tests.kits.drives import command, write_drive

EXECUTES = [
    "run {yaml}",
    "run {yaml} --dry-run",
    "online {yaml}",
    "label {yaml}",
    "tune {yaml} --trials 1 --folds 0",
    "learn {yaml} --folds 0",
    "explore {yaml} --edge x",
    "show {folder}/mine.py",
    "run quickstart --dry-run --graph {folder}/mine.py",
    "run {result}/experiment.yaml",
]
LOOKS = ["plot {result}", "plot {result} --check", "compare {result}", "show {result}/run.json"]


@pytest.mark.parametrize("words", [*EXECUTES, *LOOKS])
def test_a_program_of_a_yaml_is_executed_by_these_commands_alone(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    canary = tmp_path / "executed"
    program = (
        f"from egolane_pgm.graphs.sensor_failure import *\nopen({str(canary)!r}, 'w').close()\n"
    )
    names = "HIDDEN, OBSERVED, PARAMETERS, VALUES, tables"
    (tmp_path / "mine.py").write_text(program.replace("*", names))
    yaml = write_drive(tmp_path / "drive", graph=str(tmp_path / "mine.py"))
    result = ego.run(yaml).save(tmp_path / "result")
    # A program is loaded once in a process, by its content.
    for file in (tmp_path / "mine.py", result / "graph_mine.py"):
        file.write_text(file.read_text() + "# another\n")
    canary.unlink()
    command(*words.format(yaml=yaml, folder=tmp_path, result=result).split())
    ego.load_result(result)
    assert canary.exists() == (words in EXECUTES)
