"""Properties of every command: help, messages in one line, names of files, output."""

from __future__ import annotations

import ast
import re
import signal
import time
from pathlib import Path

import pytest

import egolane_pgm
from tests.kits.drives import refused, write_drive
from tests.kits.processes import started


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("rn", "No command 'rn' (did you mean 'run'?)."),
        ("run", "Missing argument 'EXPERIMENT|LINES'."),
        ("run x.yaml", "x.yaml: cannot be read: No such file or directory"),
        ("run quickstart --table x.csv --out", "--out"),
        ("run quickstart --table x.csv --chunk-frames 9", "--table: "),
        ("run {0}/lines.csv", "give the number of lanes"),
        ("run {0}/experiment.yaml --camera", "--camera"),
        ("plot {0} --out=", "--out: is empty"),
        ("run {0}/experiment.yaml --out=", "--out: is empty"),
        ("run {0}/experiment.yaml --ground-truth=", "--ground-truth: is empty"),
        ("run {0}/experiment.yaml --camera=", "--camera: is empty"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_one_line(
    words: str, message: str, tmp_path: Path
) -> None:
    write_drive(tmp_path)
    before = sorted(Path.cwd().iterdir())
    assert message in refused(*words.format(tmp_path).split())
    assert sorted(Path.cwd().iterdir()) == before


def test_ctrl_c_keeps_the_rows_that_are_done(tmp_path: Path) -> None:
    rows = [f"d{k},{k}" for k in range(60)]
    (tmp_path / "runs.csv").write_text("\n".join(["name,recording.seed", *rows]))
    out = tmp_path / "out"
    words = ("run", "quickstart", "--table", tmp_path / "runs.csv", "--jobs", 2, "--out", out)
    with started(*words) as process:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and len([*out.glob("*/run.json")]) < 3:
            time.sleep(0.02)
        begun = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, output = process.communicate()
    assert time.monotonic() - begun < 30
    assert process.returncode == 130
    assert "Traceback" not in output
    [line] = [line for line in output.splitlines() if line.startswith("egolane: ")]
    assert line.startswith("egolane: interrupted; finished runs and trials are kept")


def test_below_the_verbs_no_message_names_an_option_of_the_command_line() -> None:
    """Python callers read it too: it names the parameter or the key of the YAML. A message that
    begins with a parameter's name shows it as an option on the command line."""
    package = Path(str(egolane_pgm.__file__)).parent
    # The texts that commands print: the description of a recording ends with a command.
    others = {package / "command.py", package / "tools" / "options.py"}
    others |= {package / "recordings" / "showing.py"}
    others |= {package / "views" / f"{name}.py" for name in ("description", "result_text")}
    found = []
    for path in {*package.rglob("*.py")} - {*others, *(package / "verbs").iterdir()}:
        nodes = [*ast.walk(ast.parse(path.read_text()))]
        docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
        for node in nodes:
            if isinstance(node, ast.Constant) and node not in docstrings:
                found += re.findall(r"(?<![\w-])--[a-z][\w-]*", str(node.value))
    assert set(found) == {"--error-unmatch", "--porcelain"}, "git's, and others"
