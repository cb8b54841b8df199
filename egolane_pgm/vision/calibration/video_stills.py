"""Takes stills out of a video, to calibrate the camera of someone who has only a video."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.pictures import Source
from egolane_pgm.vision.camera.video import open_video
from egolane_pgm.vision.camera.writing import write_picture

#: The number of frames that are taken, spread over the video.
TAKEN = 100

#: A frame that differs from the one taken before it by no more than this, grey levels on the
#: average, shows a car at rest, which says nothing new.
_AT_REST = 0.3

#: The side of the small grey pictures that are compared.
_SMALL = 64

#: A gap of more frames than these is jumped over, a smaller one is read through.
_JUMP = 300


def take_stills(
    video: Source,
    folder: Path,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> list[Path]:
    """Writes frames of a video, spread over all of it, as pictures.

    - folder: where they are written, `frame_<position>.png`
    - progress: wraps the positions while they are read, e.g. tqdm

    Frames of a car at rest are left out. Raises InputError for a video of which no frame can be
    read, and for one that does not say how many frames it has.
    """
    if video.n_frames is None:
        raise InputError(
            f"{video.path}: does not say how many frames it has; give stills of it, as pictures"
        )
    places = np.unique(np.linspace(0, video.n_frames - 1, TAKEN).round().astype(int))
    stills: list[Path] = []
    before: FloatArray | None = None
    opened = open_video(video.files[0])
    try:
        at = 0
        for place in progress(places.tolist()):
            if place - at > _JUMP:
                opened.set(cv2.CAP_PROP_POS_FRAMES, place)
                at = place
            while at < place and opened.grab():
                at += 1
            is_there, image = opened.read()
            at += 1
            if not is_there:
                continue
            small = cv2.resize(image, (_SMALL, _SMALL), interpolation=cv2.INTER_AREA)
            seen = small.mean(axis=2, dtype=np.float64)
            if before is not None and np.abs(seen - before).mean() <= _AT_REST:
                continue
            before = seen
            stills.append(folder / f"frame_{place:06d}.png")
            write_picture(stills[-1], np.asarray(image, dtype=np.uint8))
    finally:
        opened.release()
    if not stills:
        raise InputError(f"{video.path}: none of its frames can be read")
    return stills
