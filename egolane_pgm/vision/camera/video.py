"""Reads the pictures of a video, with their positions from 0.

OpenCV gives all pictures in the size of the first one. Where a video changes its size, what comes
after is scaled to it, which fits the camera as long as the proportions stay the same. It also skips
pictures that cannot be decoded or were never recorded, without a word: such a loss is noticed only
by the number of pictures that the file states.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image


def open_video(path: Path) -> cv2.VideoCapture:
    """Opens a video before its first picture. Raises InputError for a file that is no video."""
    # Without this, FFmpeg prints its own lines about files that our one-line error explains.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with path.open("rb") as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty")
    # FFmpeg takes what is before a colon for a protocol, unless the path is absolute.
    absolute = os.path.abspath(path)
    video = cv2.VideoCapture(absolute)
    if not video.isOpened() or not video.grab():
        video.release()
        raise InputError(
            f"{path}: is no video that can be read (another kind of file, or cut off before its"
            " index was written)"
        )
    video.release()
    return cv2.VideoCapture(absolute)


def video_images(
    name: str, path: Path, n_frames: int | None, frames: tuple[int, int] | None
) -> Iterator[tuple[int, Image]]:
    """The positions and pictures of a video.

    - name: how messages name the video
    - n_frames: as the file says; None where it does not
    - frames: the first position to read and the one after the last; None for all

    Warns of a video that has fewer pictures than it says.
    """
    first, stop = frames or (0, None)
    video = open_video(path)
    at = 0
    try:
        while (stop is None or at < stop) and video.grab():
            if at >= first:
                is_there, image = video.retrieve()
                if not is_there:
                    break
                yield at, image  # type: ignore[misc]
            at += 1
    finally:
        video.release()
    if n_frames is not None and first < at < min(n_frames, stop or n_frames):
        warnings.warn(
            f"{name}: has {at} of the {n_frames} frames that it should have (cut off, damaged, or"
            " dropped when it was recorded): after such a place the frame ids are too low",
            UserWarning,
            stacklevel=2,
        )
