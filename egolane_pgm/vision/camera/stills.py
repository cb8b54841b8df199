"""Small pictures of some frames of a drive, quickly: to look at, not to measure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2

from egolane_pgm.vision.camera.bag import bag_images
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_image
from egolane_pgm.vision.camera.video import open_video
from egolane_pgm.vision.camera.writing import as_jpeg, silent

#: Of the JPEG files, per cent.
QUALITY = 70


def small_pictures(path: str, frame_ids: Sequence[int], height: int) -> dict[int, bytes]:
    """JPEG files of the frames with these ids, as far as they are there, no higher than `height`
    pixels.

    A video is entered at the place of each frame, as exactly as its format lets one.

    Raises InputError, naming the path, where there are no pictures.
    """
    images = _images(path, sorted(frame_ids))
    return {frame_id: as_jpeg(image, height, QUALITY) for frame_id, image in images}


def _images(path: str, frame_ids: Sequence[int]) -> Iterator[tuple[int, Image]]:
    source = open_source(path)
    if source.topic is not None:
        wanted = set(frame_ids)
        span = (min(wanted), max(wanted) + 1)
        for each in bag_images(Path(source.path), source.topic, span):
            if each[0] in wanted:
                yield each
        return
    if source.frame_id is not None:
        files = dict(zip(source.frame_id, source.files, strict=True))
        for frame_id in frame_ids:
            if frame_id in files:
                yield frame_id, read_image(files[frame_id])
        return
    video = open_video(source.files[0])
    try:
        for frame_id in frame_ids:
            with silent():
                video.set(cv2.CAP_PROP_POS_FRAMES, frame_id)
                is_there, image = video.read()
            if is_there:
                yield frame_id, image  # type: ignore[misc]
    finally:
        video.release()
