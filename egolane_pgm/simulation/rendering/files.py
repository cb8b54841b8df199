"""Rendered pictures written to a folder or a video."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.camera.model import Camera
from egolane_pgm.camera.writing import video_writer, write_picture
from egolane_pgm.simulation.rendering.render import render_frame
from egolane_pgm.simulation.rendering.scene import Scene

Image = NDArray[np.uint8]


@contextlib.contextmanager
def picture_writer(
    place: Path, camera: Camera, frame_rate: float, png: bool
) -> Iterator[Callable[[int, Image], None]]:
    """What writes a frame's picture to a video (.mp4) or a folder (JPEG or PNG).

    Raises InputError, then or when writing, where it cannot be written, and NotKeptError where what
    was written of a video cannot be read.
    """
    if place.suffix == ".mp4":
        with video_writer(place, frame_rate, (camera.width, camera.height)) as append:
            yield lambda _, image: append(image)
        return
    place.mkdir(parents=True, exist_ok=True)
    ending, options = ("png", []) if png else ("jpg", [cv2.IMWRITE_JPEG_QUALITY, 95])
    yield lambda k, image: write_picture(place / f"{k:06d}.{ending}", image, options)


def cost_per_frame(scene: Scene, *, png: bool, video: bool) -> tuple[float, float]:
    """Seconds of rendering, and bytes on the disk, that a frame of a drive takes, measured on a few
    (of a video: bytes of consecutive ones, which it stores as differences)."""
    few = range(min(13, len(scene))) if video else np.linspace(0, len(scene) - 1, 5).astype(int)
    seconds, frames = [], []
    for k in few:
        began = time.perf_counter()
        frames.append(render_frame(scene, int(k)))
        seconds.append(time.perf_counter() - began)
    sides = [[f.image for f in frames], [f.right for f in frames if f.right is not None]]
    n_bytes = 0
    with tempfile.TemporaryDirectory(prefix="egolane-") as folder:
        for side, pictures in enumerate(sides):
            place = Path(folder) / (f"{side}.mp4" if video else str(side))
            with picture_writer(place, scene.camera, scene.road.frame_rate, png) as write:
                for k, image in enumerate(pictures):
                    write(k, image)
            files = [place] if video else list(place.iterdir())
            n_bytes += sum(file.stat().st_size for file in files if file.exists())
    return float(np.median(seconds)), n_bytes / len(frames)
