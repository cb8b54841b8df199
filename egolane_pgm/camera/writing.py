"""Writes pictures and videos. A full disk or a vanished folder raises an error, and whatever was
written before stays readable."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2

from egolane_pgm.camera.picture import Image
from egolane_pgm.tools.files import check_name, temporary_folder, write_bytes
from egolane_pgm.types import InputError

#: Extensions of the pictures that a user may name.
PICTURES = (".png", ".jpg", ".jpeg")

#: The codec that every build of OpenCV can write.
CODEC = "mp4v"

#: Bytes that must stay free on the disk while a video is written, beside those of one picture: for
#: buffers, and per frame for the index, without which the video cannot be read.
_SPARE, _INDEX = 2 * 2**20, 64


class NotKeptError(InputError):
    """A video that was written cannot be read in full; the message says how much is left."""


def check_picture_name(path: str | Path) -> None:
    """Raises InputError for a name without an extension in `PICTURES`."""
    if Path(path).suffix.lower() not in PICTURES:
        raise InputError(f"{path}: a picture's name ends in {' or '.join(PICTURES)}")


def write_picture(
    file: Path, image: Image, options: Sequence[int] = (), *, make_folder: bool = False
) -> None:
    """Writes a picture in the format of its extension, whole or not at all.

    - image: (H, W, 3), blue green red
    - options: of OpenCV's imencode
    - make_folder: whether missing folders are made

    Raises InputError where it cannot be written.
    """
    content = cv2.imencode(file.suffix, image, list(options))[1]
    write_bytes(file, content.tobytes(), make_folder=make_folder)


def as_jpeg(image: Image, height: int, quality: int = 80) -> bytes:
    """A picture as a JPEG file, not higher than `height` pixels; quality: per cent."""
    if image.shape[0] > height:
        size = max(1, round(image.shape[1] * height / image.shape[0])), height
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(image.dtype)
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


@contextlib.contextmanager
def video_writer(
    target: Path, frame_rate: float, size: tuple[int, int]
) -> Iterator[Callable[[Image], None]]:
    """A context that gives a function to call with each picture of a video (`.mp4`) in turn.

    Whatever ends the block, the pictures written so far are kept. Without any picture there is no
    file.

    - frame_rate: Hz
    - size: width and height of the pictures, pixels

    Raises InputError while writing if the folder is gone or the disk is full (the pictures before
    are kept), and NotKeptError at the end if the video cannot be read.
    """
    check_name(target)
    if not target.parent.is_dir():
        raise InputError(f"{target}: cannot be written: no such folder")
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(temporary_folder(target.parent))
        except OSError as error:
            raise InputError(f"{target}: cannot be written: {error.strerror}") from error
        yield from _written(folder / target.name, target, frame_rate, size)


def _written(
    part: Path, target: Path, frame_rate: float, size: tuple[int, int]
) -> Iterator[Callable[[Image], None]]:
    """What `video_writer` yields, writing to `part` first; an absolute path, because FFmpeg takes
    what is before a colon for a protocol elsewhere."""
    with silent():
        video = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*CODEC), frame_rate, size)
    if not video.isOpened():
        raise InputError(f"{target}: cannot be written (is the folder writable?)")
    n_written = 0

    def write(image: Image) -> None:
        nonlocal n_written
        # On a full disk OpenCV would end the video without its index, which makes it unreadable.
        _check_room(target, part, _SPARE + image.nbytes + _INDEX * n_written)
        with silent():
            # None in versions of OpenCV that do not report failure.
            is_written = video.write(image)
        if is_written is False:
            raise InputError(f"{target}: cannot be written, the system takes no more of it")
        n_written += 1

    try:
        yield write
    finally:
        with silent():
            video.release()
        if n_written:
            _put(part, target, n_written)


def _check_room(target: Path, part: Path, needed: int) -> None:
    try:
        part.stat()
        disk = shutil.disk_usage(part.parent)
    except OSError as error:
        raise InputError(f"{target}: cannot be written any more: {error.strerror}") from None
    # Some file systems do not report their size.
    if disk.total and disk.free < needed:
        raise InputError(
            f"{target}: the disk is full ({disk.free / 1e6:.1f} MB left, a video needs"
            f" {needed / 1e6:.1f} MB to end well)"
        )


def _put(part: Path, target: Path, n_written: int) -> None:
    """Gives a finished video its final name, if it can be read."""
    n_there = _count(part)
    if n_there == 0:
        why = "is the disk full, or a limit reached?" if part.exists() else "its folder is gone"
        raise NotKeptError(
            f"{target}: cannot be written ({why}); nothing of the {n_written} frames is kept"
        )
    try:
        part.replace(target)
    except OSError as error:
        kept = target.with_name(f"{target.stem}_{part.parent.name[-8:]}{target.suffix}")
        part.rename(kept)
        raise NotKeptError(
            f"{target}: cannot be written: {error.strerror}; the video is in {kept}"
        ) from None
    if n_there < n_written:
        raise NotKeptError(
            f"{target}: has {n_there} of {n_written} frames, the others could not be written (is"
            " the disk full, or a limit reached?)"
        )


def _count(video: Path) -> int:
    """How many frames can be read, according to the video's index."""
    if not video.is_file():
        return 0
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with silent():
        read = cv2.VideoCapture(str(video))
        is_readable = read.isOpened() and read.grab()
        count = int(read.get(cv2.CAP_PROP_FRAME_COUNT)) if is_readable else 0
        read.release()
    return max(0, count)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Silences OpenCV's own messages, for which we raise a one-line error."""
    # The function's place differs between OpenCV's major versions.
    set_level: Any = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    before = set_level(0)
    try:
        yield
    finally:
        set_level(before)
