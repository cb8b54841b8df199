"""The command `reproduce` where the recordings are not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from egolane_pgm.recordings import catalog


def answer(text: str) -> Callable[..., str]:
    def confirm(question: str) -> str:
        assert question.startswith("Download the paper's recordings (18 MB) to ")
        return text

    return confirm


@pytest.mark.parametrize("reply", ["y", "n"])
def test_the_download_is_offered_where_somebody_can_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reply: str
) -> None:
    fetched: list[bool] = []

    def fetch() -> list[catalog.Outcome]:
        fetched.append(True)
        file = catalog.list_files()[0]
        return [catalog.Outcome(file, tmp_path / "x", "failed", "the server is down")]

    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("egolane_pgm.verbs.reproduce.sys.stdin", Terminal())
    monkeypatch.setattr("builtins.input", answer(reply))
    monkeypatch.setattr(catalog, "fetch", fetch)
    from egolane_pgm.verbs.reproduce import _have_recordings

    assert not _have_recordings()
    assert len(fetched) == (reply == "y")


class Terminal:
    def isatty(self) -> bool:
        return True
