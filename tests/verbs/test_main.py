"""What holds for every command: help, messages in one line, names of files, output."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.kits.drives import refused, write_drive


@pytest.mark.parametrize("verb", ["run", "learn", "tune", "label", "online"])
def test_a_road_of_more_lanes_than_there_are_is_refused_at_once(verb: str, tmp_path: Path) -> None:
    words = (write_drive(tmp_path, 30), "--set", "n_lanes=1000000000")
    assert "n_lanes: input should be less than or equal to 50" in refused(verb, *words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("rn", "No command 'rn' (did you mean 'run'?)."),
        ("run", "Missing argument 'EXPERIMENT|LINES'."),
        ("run x.yaml --filter stamp", "egolane run --help"),
        ("run x.yaml", "x.yaml: cannot be read: No such file or directory"),
        ("run quickstar", "quickstar: is no file, and no experiment that `egolane show` lists"),
        ("run quickstart --table x.csv --out", "--out"),
        ("run quickstart --table x.csv --chunk-frames 9", "--table: "),
        ("run {0}/lines.csv", "give the number of lanes"),
        ("run {0}/experiment.yaml --camera", "--camera"),
        ("plot", "Missing argument 'RESULTS...'."),
        ("plot {0} --out=", "--out: is empty"),
        ("run {0}/experiment.yaml --out=", "--out: is empty"),
        ("run {0}/experiment.yaml --ground-truth=", "--ground-truth: is empty"),
        ("run {0}/experiment.yaml --camera=", "--camera: is empty"),
        ("reproduce --runs 11", "run 11: the paper has runs 1 to 10"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_one_line(
    words: str, said: str, tmp_path: Path
) -> None:
    write_drive(tmp_path)
    before = sorted(Path.cwd().iterdir())
    assert said in refused(*words.format(tmp_path).split())
    assert sorted(Path.cwd().iterdir()) == before
