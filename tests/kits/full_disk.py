"""A disk that becomes full after a while."""

from __future__ import annotations

import errno
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest

Usage = namedtuple("Usage", "total used free")

#: A detector that does something when it sees a frame.
BLIND = """
import shutil
from egolane_pgm.detectors import ml
STEREO, PARAMETERS = False, ml.PARAMETERS
def start(camera, parameters):
    step = ml.start(camera, parameters)
    def seen(picture):
        if picture.frame_id == 5:
            {}
        return step(picture)
    return seen
"""


def drawing(place: Path, kind: str, target: Path, *more: object) -> list[object]:
    lanes = ["--n-lanes", 2] if kind == "video" else []
    return [kind, place / "drive.avi", "--camera", place / "cam.yaml", "-o", target, *lanes, *more]


def left(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def full_after(monkeypatch: pytest.MonkeyPatch, n_files: int) -> None:
    """A disk that takes so many pictures and a part of the next one."""
    real: Callable[[Path, bytes], int] = Path.write_bytes
    n_written = 0

    def write(path: Path, content: bytes) -> int:
        nonlocal n_written
        n_written += path.suffix in (".png", ".jpg")
        if n_written > n_files:
            real(path, content[:10])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", write)
