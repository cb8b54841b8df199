"""The public data set: found, downloaded from a local server, checked, never spoiled."""

from __future__ import annotations

import functools
import hashlib
import http.server
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from egolane_pgm.recordings import catalog
from egolane_pgm.recordings.catalog import (
    DataFile,
    fetch,
    list_files,
    problems,
    verify,
)
from egolane_pgm.types import InputError

CONTENT = {
    "one.bag": bytes(range(256)) * 2000,
    "two with space.bag": b"two" * 100_000,
    "gt.txt": b"1;1;0\n",
}


@pytest.fixture
def mirror(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """The folder of a server."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    files = tuple(
        DataFile(hashlib.sha256(body).hexdigest(), len(body), name)
        for name, body in CONTENT.items()
    )
    monkeypatch.setattr(catalog, "list_files", lambda: files)
    folder = tmp_path / "served"
    folder.mkdir()
    for name, body in CONTENT.items():
        (folder / name).write_bytes(body)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        monkeypatch.setattr(catalog, "BASE_URL", f"http://127.0.0.1:{server.server_address[1]}")
        threading.Thread(target=server.serve_forever, args=(0.01,)).start()
        yield folder
        server.shutdown()


def statuses(outcomes: list[catalog.Outcome]) -> dict[str, str]:
    return {outcome.file.name: outcome.status for outcome in outcomes}


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "rle").iterdir()}


def test_the_recordings_at_hand_are_those_of_the_catalogue() -> None:
    if "EGOLANE_DATA" not in os.environ:
        pytest.skip("the paper's recordings: needs EGOLANE_DATA")
    folder = Path(os.environ["EGOLANE_DATA"])
    assert problems(verify(folder)) == []
    assert all((folder / f.target).stat().st_size == f.size for f in list_files())


def test_all_files_are_fetched_and_then_not_asked_for_again(mirror: Path, tmp_path: Path) -> None:
    assert set(statuses(fetch(tmp_path)).values()) == {"downloaded"}
    assert files_in(tmp_path) == CONTENT
    (mirror / "one.bag").unlink()
    assert set(statuses(fetch(tmp_path)).values()) == {"present"}


def test_the_download_folder_is_in_the_cache_of_the_user(
    mirror: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    fetch()
    assert set(files_in(tmp_path / "egolane_pgm")) == set(CONTENT)
    assert [o.status for o in verify()] == ["present"] * 3


def test_wrong_content_is_refused_and_takes_the_place_of_nothing(
    mirror: Path, tmp_path: Path
) -> None:
    (tmp_path / "rle").mkdir()
    (tmp_path / "rle" / "one.bag").write_bytes(b"my own notes")
    (mirror / "one.bag").write_bytes(CONTENT["one.bag"][:-1] + b"x")
    assert statuses(verify(tmp_path))["one.bag"] == "bad"
    outcomes = fetch(tmp_path)
    assert [outcome.status for outcome in outcomes] == ["failed", "downloaded", "downloaded"]
    (line,) = problems(outcomes)
    assert "one.bag: not downloaded" in line
    assert "wrong checksum" in line
    assert files_in(tmp_path) == {**CONTENT, "one.bag": b"my own notes"}


def test_a_dead_network_is_said_in_one_line(
    mirror: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalog, "BASE_URL", "http://127.0.0.1:9/never-the-real-one")
    with pytest.raises(InputError, match="no connection; is the network up"):
        fetch(tmp_path)
