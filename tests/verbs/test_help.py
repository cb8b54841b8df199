"""The help of all commands is that of help.txt. Its examples are command lines that exist."""

from __future__ import annotations

import os
import shlex
from importlib import import_module
from pathlib import Path

import click
import pytest

from egolane_pgm.command import COMMANDS, egolane
from tests.kits.drives import done

HELP = Path(__file__).with_name("help.txt")

#: The examples of each command.
EXAMPLES = {name: import_module(f"egolane_pgm.verbs.{name}").EXAMPLES for name in COMMANDS}


def words_of(example: str) -> list[str]:
    return shlex.split(example.partition(" > ")[0].partition(" < ")[0])


def test_the_help_is_the_one_that_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """`EGOLANE_REMAKE_HELP=1 pytest tests/verbs/test_help.py` keeps the help as it is now."""
    monkeypatch.setenv("COLUMNS", "80")
    commands = [(), *((name,) for name in COMMANDS)]
    shown = "\n".join(done(*words, "--help").stdout for words in commands)
    if os.environ.get("EGOLANE_REMAKE_HELP"):
        HELP.write_text(shown)
    assert shown == HELP.read_text()


def test_every_command_has_an_example_of_its_own() -> None:
    for name, examples in EXAMPLES.items():
        assert examples
        assert all(example.startswith(f"egolane {name}") for example in examples)


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
