"""What a shell completes when the tab key is pressed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from egolane_pgm.plugins import plugin_names


def completed(*words: str) -> list[str]:
    """What bash is told could stand for the last word."""
    given = {
        "_EGOLANE_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(["egolane", *words]),
        "COMP_CWORD": str(len(words)),
    }
    program = "from egolane_pgm.command import main; main()"
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **given},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stderr == ""
    return [line.partition(",")[2] for line in ran.stdout.split()]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ru",), ["run"]),
        (("compare", "--wi"), ["--with-paper", "--wide"]),
        (("network", "no"), [n for n in plugin_names("graphs") if n.startswith("no")]),
        (("compare", "--graphs", "no_wor,lane"), ["no_wor,lane_only"]),
        (("detect", "--detector", ""), plugin_names("detectors")),
        (("show", "counting_"), ["counting_levels"]),
        (("reproduce", "--format", "la"), ["latex"]),
    ],
)
def test_names_are_completed(words: tuple[str, ...], expected: list[str]) -> None:
    assert completed(*words) == expected


def test_names_of_files_are_left_to_the_shell() -> None:
    for words in (("run", "exp"), ("detect", "--detector", "./my"), ("network", "mine.y")):
        assert completed(*words) == [words[-1]]
