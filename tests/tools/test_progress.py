"""A bar of progress is drawn in a terminal, and nowhere else unless it is asked for."""

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


@pytest.mark.parametrize(
    ("progress", "is_terminal", "is_shown"),
    [(None, True, True), (None, False, False), (True, False, True), (False, True, False)],
)
def test_a_bar_is_shown_in_a_terminal_or_where_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    progress: bool | None,
    is_terminal: bool,
    is_shown: bool,
) -> None:
    terminal = Terminal()
    if is_terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
    assert list(bar(range(3), progress, unit="frame")) == [0, 1, 2]
    with bar(None, progress, total=3, unit="frame") as shows:
        shows.update(3)
    said = terminal.text if is_terminal else capsys.readouterr().err
    assert ("0/3" in said) == is_shown
    assert bool(said) == is_shown
