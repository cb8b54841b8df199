"""Rendered pictures written to a folder or a video."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.camera import Camera
from egolane_pgm.types import InputError

Image = NDArray[np.uint8]


def picture_writer(
    place: Path, camera: Camera, frame_rate: float, png: bool
) -> tuple[Callable[[int, Image], None], Callable[[], None]]:
    """What writes a frame's picture to a video (.mp4) or a folder (JPEG or PNG), and what ends it.

    Raises InputError, then or when writing, where it cannot be written.
    """
    if place.suffix == ".mp4":
        codec = cv2.VideoWriter.fourcc(*"mp4v")
        video = cv2.VideoWriter(str(place), codec, frame_rate, (camera.width, camera.height))
        if not video.isOpened():
            raise InputError(f"{place}: cannot be written as a video")

        def append(_: int, image: Image) -> None:
            video.write(image)

        return append, video.release
    place.mkdir(exist_ok=True)

    def write(frame_id: int, image: Image) -> None:
        target = place / f"{frame_id:06d}.{'png' if png else 'jpg'}"
        options = [] if png else [cv2.IMWRITE_JPEG_QUALITY, 95]
        if not cv2.imwrite(str(target), image, options):
            raise InputError(f"{target}: cannot be written")

    return write, lambda: None
