"""The check of the budgets in pyproject.toml, run by `make check`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / ".ci" / "budget"

#: A project with 6 tokens in a folder, 3 in a file, 3 in the tests, 9 in makers, and 2 words.
FILES = {
    "egolane_pgm/views/deep/table.py": '"""About it."""\n\na = 1  # one\n\n\nb = 2\n',
    "egolane_pgm/types.py": "a = 1\n",
    "tests/test_a.py": "a = 1\n",
    "makers/a.py": "a = 1\n" * 3,
    "docs/a.md": "two words\n",
}
FITTING = {"views": 6, '"types.py"': 25, "tests": 3, "makers": 9, "words": 2}


def check(root: Path, budget: dict[str, int]) -> tuple[int, list[str]]:
    """The exit status and the lines of the check of the project above with a budget."""
    rows = "".join(f"{room} = {size}\n" for room, size in budget.items())
    files = {**FILES, "pyproject.toml": f"[tool.egolane.budget]\n{rows}"}
    for name, content in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(content)
    ran = subprocess.run(
        [sys.executable, str(SCRIPT), str(root)], capture_output=True, text=True, timeout=60
    )
    return ran.returncode, ran.stderr.splitlines()


def test_rooms_within_their_budgets_pass(tmp_path: Path) -> None:
    assert check(tmp_path, FITTING) == (0, [])


@pytest.mark.parametrize(
    ("budget", "message"),
    [
        ({**FITTING, "views": 5}, "views: 6 tokens, the budget is 5: take 1 out"),
        ({**FITTING, "words": 0}, "words: 2 words, the budget is 0: take 2 out"),
        ({**FITTING, "maps": 25}, "maps: has a budget but no longer exists"),
        ({k: FITTING[k] for k in FITTING if k != "tests"}, "tests: 3 tokens, no budget"),
    ],
)
def test_a_room_without_its_budget_is_named(
    tmp_path: Path, budget: dict[str, int], message: str
) -> None:
    status, [line] = check(tmp_path, budget)
    assert status == 1
    assert line.startswith(message)
