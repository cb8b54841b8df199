"""A bar of progress is drawn in a terminal only."""

from __future__ import annotations

import sys

import pytest

from egolane_pgm.tools.progress import bar


class Terminal:
    def __init__(self) -> None:
        self.text = ""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        pass


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_bar_is_shown_in_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_terminal: bool
) -> None:
    terminal = Terminal()
    if is_terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
    assert list(bar(range(3), unit="frame")) == [0, 1, 2]
    with bar(total=3, unit="frame") as shows:
        shows.update(3)
    said = terminal.text if is_terminal else capsys.readouterr().err
    assert ("0/3" in said) == bool(said) == is_terminal
