"""What a shell completes when the tab key is pressed, and how little is imported for it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from egolane_pgm.cli.main import COMMANDS, egolane
from egolane_pgm.plugins import plugin_names
from egolane_pgm.tuning.search import SAMPLERS

#: Prints the options of each command, and which heavy packages are imported.
LIGHTLY = """
import json, sys
from egolane_pgm.cli.completion import import_lightly
import_lightly()
from egolane_pgm.cli.main import COMMANDS, egolane
found = {name: [p.name for p in egolane.get_command(None, name).params] for name in COMMANDS}
heavy = [name for name in ("numpy", "numba", "cv2", "optuna", "scipy", "pandas", "matplotlib",
                           "pydantic", "yaml") if hasattr(sys.modules.get(name), "__file__")]
print(json.dumps([found, heavy]))
"""


def completed(*words: str, folder: Path | None = None) -> list[str]:
    """What bash is told could stand for the last word."""
    given = {
        "_EGOLANE_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(["egolane", *words]),
        "COMP_CWORD": str(len(words)),
    }
    program = "from egolane_pgm.cli.entry import main; main()"
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **given},
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stderr == ""
    return [line.partition(",")[2] for line in ran.stdout.split()]


def test_every_command_is_completed_without_what_it_needs_to_run() -> None:
    ran = subprocess.run(
        [sys.executable, "-c", LIGHTLY], capture_output=True, text=True, check=True
    )
    found, heavy = json.loads(ran.stdout)
    assert heavy == []
    for name in COMMANDS:
        command = egolane.get_command(None, name)  # type: ignore[arg-type]
        assert command is not None
        assert found[name] == [parameter.name for parameter in command.params]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ru",), ["run"]),
        (("compare", "--wi"), ["--with-paper", "--wide"]),
        (("network", "no"), [n for n in plugin_names("graphs") if n.startswith("no")]),
        (("compare", "--graphs", "no_wor,lane"), ["no_wor,lane_only"]),
        (("detect", "--detector", ""), plugin_names("detectors")),
        (("tune", "--sampler", ""), list(SAMPLERS)),
        (("show", "counting_"), ["counting_levels"]),
        (("reproduce", "--format", "la"), ["latex"]),
    ],
)
def test_names_are_completed(words: tuple[str, ...], expected: list[str]) -> None:
    assert completed(*words) == expected


def test_experiments_are_completed_and_other_files_are_not(tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    for name in ("a.yaml", "a.csv", "more/b.yml"):
        (tmp_path / name).write_text("")
    assert completed("run", "", folder=tmp_path) == ["a.yaml", "more/", "experiments/"]
    assert completed("run", "./a", folder=tmp_path) == ["./a.yaml"]
    assert completed("run", "experiments/qu", folder=tmp_path) == ["experiments/quickstart.yaml"]
    assert completed("validate", "more/", folder=tmp_path) == ["more/b.yml"]
    assert completed("tune", f"{tmp_path}/mo") == [f"{tmp_path}/more/"]
    assert completed("learn", "absent/x", folder=tmp_path) == []
