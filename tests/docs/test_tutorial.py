"""The tutorial shows the output of its commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.kits.drives import command

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.md"


def squeezed(line: str) -> str:
    """The line with single blanks and dashes: a column may be wider than it was shown."""
    return re.sub(r"([ -])\1+", r"\1", line).strip()


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_line_of_output_that_the_tutorial_shows_is_printed(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = TUTORIAL.read_text().replace("\\\n", " ")
    printed: set[str] = set()
    shown = 0
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, flags=re.M | re.S):
        if language == "":
            for line in re.findall(r"^egolane ((?:run|simulate) .*)$", block, flags=re.M):
                quick = ["--no-figures"] if line.startswith("run") else []
                result = command(*shlex.split(line, comments=True), *quick)
                assert result.exit_code == 0, result.output
                printed |= set(map(squeezed, result.output.splitlines()))
        elif language == "output":
            lines = [squeezed(line) for line in block.splitlines() if line]
            assert not [line for line in lines if line not in printed]
            shown += len(lines)
    assert shown > 20
