"""One file over HTTP: continued where it stopped, checked, and only then put in its place."""

from __future__ import annotations

import http.client
import os
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from egolane_pgm.types import InputError

_CHUNK = 1 << 16
#: How often a download that was cut is taken up again, as long as each time brings more of it.
_ATTEMPTS = 5


class Unreachable(InputError):
    """The server cannot be reached at all; the line names the host, not the file."""


def is_good(path: Path, sha256: str) -> bool:
    """The file is there and has this sha256."""
    import pooch

    return path.is_file() and pooch.file_hash(str(path), alg="sha256") == sha256


def download(
    url: str,
    path: Path,
    *,
    size: int,
    sha256: str,
    timeout_s: float = 30.0,
    on_bytes: Callable[[int], None] = lambda n: None,
    stop: threading.Event | None = None,
) -> None:
    """Fetch `url` into `path`, which is replaced only by content that has this sha256.

    What has come so far stays in `<name>.part` when the connection breaks, and the next call
    asks for the rest only, if the server can do that (Range requests). on_bytes: told of every
    piece, negative where a part is thrown away. stop: set it to end soon, keeping the part.

    Raises InputError, one line, for a server that cannot be reached (Unreachable) or does not
    have the file, a download of it that is running already, content with another checksum, a
    connection that breaks again and again, a folder that cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _alone(part):
            if _size(part) > size:  # cannot be the beginning of the file
                os.truncate(part, 0)
            continued = _size(part)
            on_bytes(continued)
            _complete(url, part, size, timeout_s, on_bytes, stop)
            if continued and not is_good(part, sha256):  # the part was from something else
                on_bytes(-_size(part))
                os.truncate(part, 0)
                _complete(url, part, size, timeout_s, on_bytes, stop)
            if not is_good(part, sha256):
                got = _size(part)
                os.truncate(part, 0)
                raise InputError(
                    f"{path.name}: {url} sends something else (wrong checksum, {got} bytes for"
                    f" {size}); not used, try another mirror"
                )
            os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def _alone(part: Path) -> Iterator[None]:
    """Hold the part for this download alone, where the system has such locks.

    Without it a second process could go on writing to the part after the first has checked it and
    put it in place. An empty part is removed in the end.
    """
    with part.open("ab") as file:
        try:
            import fcntl
        except ImportError:
            file.close()  # such systems do not replace a file that is open
        else:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{part.stem}: is being downloaded by another process") from None
        try:
            yield
        finally:
            if part.exists() and _size(part) == 0:
                part.unlink()


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _complete(
    url: str,
    part: Path,
    size: int,
    timeout_s: float,
    on_bytes: Callable[[int], None],
    stop: threading.Event | None,
) -> None:
    """Ask for what is missing until the part has `size` bytes, or more: then it is wrong."""
    why = ""
    for _ in range(_ATTEMPTS):
        before = _size(part)
        if before >= size:
            return
        why = _request(url, part, size, timeout_s, on_bytes, stop)
        if not why:
            return
        if _size(part) <= before:
            break
    raise InputError(
        f"{part.stem}: {url}: {why} after {_size(part)} of {size} bytes;"
        " run it again to continue from there"
    )


def _request(
    url: str,
    part: Path,
    size: int,
    timeout_s: float,
    on_bytes: Callable[[int], None],
    stop: threading.Event | None,
) -> str:
    """One request for the rest. "" when the answer came whole, else why it did not."""
    have = _size(part)
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
    try:
        answer = urllib.request.urlopen(request, timeout=timeout_s)
    except urllib.error.HTTPError as error:
        with error:
            raise InputError(
                f"{part.stem}: {url}: the server says {error.code} {error.reason}"
            ) from None
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        text = " ".join(str(reason).split()) or type(error).__name__
        raise Unreachable(
            f"no connection to {urlsplit(url).netloc} ({text}); is the network up?"
            " --base-url takes a mirror"
        ) from None
    with answer:
        goes_on = answer.status == 206 and str(answer.headers.get("Content-Range", "")).startswith(
            f"bytes {have}-"
        )
        if have and not goes_on:
            on_bytes(-have)
            have = 0
        with part.open("ab" if have else "wb") as file:
            return _copy(answer, file.write, size - have, on_bytes, stop)


def _copy(
    answer: http.client.HTTPResponse,
    write: Callable[[bytes], object],
    wanted: int,
    on_bytes: Callable[[int], None],
    stop: threading.Event | None,
) -> str:
    """Write what comes, one byte beyond `wanted` at most: an endless answer shows up as wrong."""
    got = 0
    declared = answer.length  # None without Content-Length: then the end of the stream is the end
    while got <= wanted:
        if stop is not None and stop.is_set():
            return "stopped"
        try:
            piece = answer.read(min(_CHUNK, wanted + 1 - got))
        except (OSError, http.client.HTTPException) as error:
            return f"the connection broke ({' '.join(str(error).split()) or type(error).__name__})"
        if not piece:
            break
        write(piece)
        got += len(piece)
        on_bytes(len(piece))
    if declared is not None and got < min(declared, wanted):
        return "the connection broke"
    return ""
