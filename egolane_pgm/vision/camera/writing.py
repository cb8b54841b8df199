"""Writes pictures and videos."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2

from egolane_pgm.tools.files import check_place, temporary_folder, write_bytes
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image

#: The codec that every build of OpenCV can write.
CODEC = "mp4v"


def write_picture(file: Path, image: Image) -> None:
    """Write a picture, (H, W, 3), blue green red, in the format of its extension, whole or not at
    all; missing folders are made. Raises InputError where it cannot be written."""
    write_bytes(file, cv2.imencode(file.suffix, image)[1].tobytes())


def as_jpeg(image: Image, height: int) -> bytes:
    """A picture as a JPEG file, not higher than `height` pixels."""
    if image.shape[0] > height:
        size = max(1, round(image.shape[1] * height / image.shape[0])), height
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(image.dtype)
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())


@contextlib.contextmanager
def video_writer(
    target: Path, frame_rate: float, size: tuple[int, int]
) -> Iterator[Callable[[Image], None]]:
    """A context that gives a function to call with each picture of a video (`.mp4`) in turn.

    The pictures written so far are kept if the block raises. Without a picture, no file is written.

    - frame_rate: Hz
    - size: width and height of the pictures, pixels

    Raises InputError if the video cannot be written.
    """
    check_place(target)
    with temporary_folder(target.parent) as folder:
        # FFmpeg takes the text before a colon for a protocol, unless the path is absolute, as in a
        # temporary folder.
        part = folder / target.name
        with silent():
            video = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*CODEC), frame_rate, size)
        if not video.isOpened():
            raise InputError(f"{target}: cannot be written (is the folder writable?)")
        is_begun = False

        def write(image: Image) -> None:
            nonlocal is_begun
            video.write(image)
            is_begun = True

        try:
            yield write
        finally:
            video.release()
            if is_begun:
                part.replace(target)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Silence OpenCV's own messages, for which we raise a one-line error."""
    # The function's place differs between OpenCV's major versions.
    set_level: Any = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    before = set_level(0)
    try:
        yield
    finally:
        set_level(before)
