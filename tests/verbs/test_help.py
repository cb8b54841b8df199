"""The help of all commands is that of help.txt. Its examples are command lines that exist, and
those that need no pictures, no map and no recordings of the paper are run."""

from __future__ import annotations

import os
import shlex
from importlib import import_module
from pathlib import Path

import click
import pytest

from egolane_pgm.command import COMMANDS, command_of, egolane
from tests.kits.drives import done

HELP = Path(__file__).with_name("help.txt")

#: The examples of each command.
EXAMPLES = {name: import_module(f"egolane_pgm.verbs.{name}").EXAMPLES for name in COMMANDS}

#: In an order in which each finds what it needs, on a shorter drive.
RUN = {
    "egolane simulate a4 --out drive --frames 600": [],
    "egolane ls": [],
    "egolane schema > experiment.schema.json": [],
    "egolane validate drive/experiment.yaml experiments/zero_label.yaml": [],
    "egolane lines drive/lines.csv --frame 7": [],
    "egolane convert drive/lines.csv lines.parquet": [],
    "egolane network sensor_failure graph.svg": [],
    "egolane show sensor_failure --tables": [],
    "egolane show detector:ml --json -": [],
    "egolane run experiments/quickstart.yaml --set parameters.sigma1=0.3": ["--no-figures"],
    "egolane plot results/quickstart --frames 0 400 --style pdf": [],
    "egolane run experiments/zero_label.yaml --recording drive/lines.csv --n-lanes 4 --out mine": [
        "--no-figures"
    ],
    "egolane label drive/lines.csv --n-lanes 4 --out labels": ["--no-figures"],
    "egolane learn drive/experiment.yaml --out learned.yaml": ["--blocks", "2"],
    "egolane tune drive/experiment.yaml --trials 300": [
        *("--trials", "3", "--in-sample-only", "--no-figures", "--jobs", "1")
    ],
    "egolane compare experiments/quickstart.yaml --graphs sensor_failure,lane_only": [
        *("--blocks", "2")
    ],
}


def words_of(example: str) -> list[str]:
    return shlex.split(example.partition(" > ")[0].partition(" < ")[0])


def test_the_help_is_the_one_that_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """`EGOLANE_REMAKE_HELP=1 pytest tests/verbs/test_help.py` keeps the help as it is now."""
    monkeypatch.setenv("COLUMNS", "80")
    commands = [(), *((name,) for name in COMMANDS)]
    group = command_of("data")
    assert isinstance(group, click.Group)
    commands += [("data", name) for name in group.commands]
    shown = "\n".join(done(*words, "--help").stdout for words in commands)
    if os.environ.get("EGOLANE_REMAKE_HELP"):
        HELP.write_text(shown)
    assert shown == HELP.read_text()


def test_every_command_has_an_example_of_its_own() -> None:
    for name, examples in EXAMPLES.items():
        assert examples
        assert all(example.startswith(f"egolane {name}") for example in examples)
    assert set(RUN) <= {example for examples in EXAMPLES.values() for example in examples}


@pytest.mark.parametrize("example", [e for examples in EXAMPLES.values() for e in examples])
def test_an_example_is_a_command_line_that_exists(
    example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _, name, *words = words_of(example)
    command = egolane.get_command(click.Context(egolane), name)
    assert command is not None
    with command.make_context(name, words):
        pass


def test_examples_run_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for example, quicker in RUN.items():
        done(*words_of(example)[1:], *quicker)
