"""What a shell completes when the tab key is pressed."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from egolane_pgm.command import egolane
from egolane_pgm.plugins import plugin_names


def completed(*words: str) -> list[str]:
    """What bash is told could stand for the last word."""
    given = {
        "_EGOLANE_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(["egolane", *words]),
        "COMP_CWORD": str(len(words)),
    }
    ran = CliRunner().invoke(egolane, prog_name="egolane", env=given)
    assert (ran.exit_code, ran.stderr) == (0, "")
    return [line.partition(",")[2] for line in ran.stdout.split()]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ru",), ["run"]),
        (("compare", "--wi"), ["--with-paper", "--wide"]),
        (("compare", "--graphs", "no_wor,lane"), ["no_wor,lane_only"]),
        (("detect", "--detector", ""), plugin_names("detectors")),
        (("reproduce", "--format", "la"), ["latex"]),
    ],
)
def test_names_are_completed(words: tuple[str, ...], expected: list[str]) -> None:
    assert completed(*words) == expected


def test_names_of_files_are_left_to_the_shell() -> None:
    for words in (("run", "exp"), ("detect", "--detector", "./my"), ("show", "mine.y")):
        assert completed(*words) == [words[-1]]
