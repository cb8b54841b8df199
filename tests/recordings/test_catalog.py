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
from egolane_pgm.recordings.catalog import DataFile, fetch, list_files
from egolane_pgm.types import InputError

CONTENT = {
    "one.bag": bytes(range(256)) * 2000,
    "two with space.bag": b"two" * 100_000,
    "gt.txt": b"1;1;0\n",
}


@pytest.fixture
def mirror(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """The folder of a server; the download folder is tmp_path / "egolane_pgm"."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("EGOLANE_DATA", raising=False)
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


def statuses() -> list[str]:
    return [file.status for file in catalog.list_files()]


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "egolane_pgm" / "rle").iterdir()}


def test_the_recordings_have_the_checksums_of_the_catalogue() -> None:
    if "EGOLANE_DATA" not in os.environ:
        pytest.skip("the paper's recordings: needs EGOLANE_DATA")
    assert {file.status for file in list_files()} == {"present"}
    assert all(file.path.stat().st_size == file.size for file in list_files())


def test_the_download_folder_is_the_cache_of_pooch(monkeypatch: pytest.MonkeyPatch) -> None:
    import pooch

    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    assert catalog.data_folders() == [pooch.os_cache("egolane_pgm")]


def test_files_are_downloaded_once(mirror: Path, tmp_path: Path) -> None:
    assert fetch() == []
    assert files_in(tmp_path) == CONTENT
    (mirror / "one.bag").unlink()
    assert fetch() == []
    assert statuses() == ["present"] * 3


def test_wrong_content_is_refused_and_replaces_no_file(mirror: Path, tmp_path: Path) -> None:
    (tmp_path / "egolane_pgm" / "rle").mkdir(parents=True)
    (tmp_path / "egolane_pgm" / "rle" / "one.bag").write_bytes(b"my own notes")
    (mirror / "one.bag").write_bytes(CONTENT["one.bag"][:-1] + b"x")
    assert statuses() == ["bad", "missing", "missing"]
    (problem,) = fetch()
    assert "one.bag: not downloaded" in problem
    assert "does not match the known hash" in problem
    assert files_in(tmp_path) == {**CONTENT, "one.bag": b"my own notes"}


def test_a_dead_network_is_reported_in_one_line(
    mirror: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalog, "BASE_URL", "http://127.0.0.1:9/never-the-real-one")
    with pytest.raises(InputError, match="no connection; is the network up"):
        fetch()
