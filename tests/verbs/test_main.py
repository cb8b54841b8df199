"""What holds for every command: help, messages in one line, names of files, output."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import egolane_pgm
from tests.kits.drives import refused, write_drive
from tests.kits.synthetic_road import write_place


def test_a_road_of_more_lanes_than_there_are_is_refused_at_once(labels: Path) -> None:
    words = (write_drive(labels.parent / "x", 30), "--set", "n_lanes=1000000000")
    for name in ("run", "learn", "compare", "tune"):
        assert "n_lanes: input should be less than or equal to 50" in refused(name, *words)
    said = refused("show", "lane_only", "--n-lanes", 51)
    assert "'--n-lanes': 51 is not in the range" in said


def test_a_command_line_that_makes_no_sense_is_one_line() -> None:
    assert "No such command 'rn'" in refused("rn")
    assert "egolane run --help" in refused("run", "x.yaml", "--filter", "stamp")
    assert "Missing argument" in refused("plot")
    assert refused("run") == "run: name an experiment, or a recording of lines"
    said = refused("run", "quickstart", "--stream", "--recording", "a", "--recording", "b")
    assert said.startswith("--stream: goes with one experiment")
    assert "--trials" in refused("tune", "x.yaml", "--trials", "0")


def test_empty_names_are_not_taken_for_the_folder_one_is_in(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    write_place(tmp_path, 3)
    before = sorted(Path.cwd().iterdir())
    for option in ("--recording", "--ground-truth", "--camera", "--out"):
        assert "is empty" in refused("run", path, option, "")
    assert "--out: is empty" in refused("plot", tmp_path, "--out", "")
    assert sorted(Path.cwd().iterdir()) == before


def test_below_the_verbs_no_message_names_an_option_of_the_command_line() -> None:
    """Python callers read it too: it names the parameter or the key of the YAML. A message that
    begins with a parameter's name shows it as an option on the command line."""
    package = Path(str(egolane_pgm.__file__)).parent
    # The description of a recording ends with the command that runs it.
    others = {package / "command.py", package / "recordings" / "showing.py"}
    found = []
    for path in {*package.rglob("*.py")} - {*others, *(package / "verbs").iterdir()}:
        nodes = [*ast.walk(ast.parse(path.read_text()))]
        docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
        for node in nodes:
            if isinstance(node, ast.Constant) and node not in docstrings:
                found += re.findall(r"(?<![\w-])--[a-z][\w-]*", str(node.value))
    assert set(found) == {"--error-unmatch", "--porcelain"}, "git's, and others"
