"""Reads the pictures of a drive from a video, a folder, a glob or a bag, for one camera or for two.

The frame id of a picture in a video or a bag is its position, from 0. Picture files are taken in
natural order (`img_9.jpg` before `img_10.jpg`). Their frame ids are the last number of the names
that increases from file to file; if there is none, their positions, from 0. Only one picture is in
memory at a time.

OpenCV gives all pictures of a video in the size of the first one. It also skips pictures that
cannot be decoded or were never recorded, without a word: such a loss is noticed only by the number
of pictures that the file states.
"""

from __future__ import annotations

import base64
import glob
import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.recordings import FORMATS, files_of
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.topics import messages, topics_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import NOTE, FloatArray, InputError, problems_in
from egolane_pgm.vision.camera.model import USUAL_HEIGHTS, Camera, said_height, scaled
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.camera.writing import silent

#: Extensions of picture files; any other file is read as a video.
PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")

#: The message types of pictures in a bag, in any package.
_KINDS = ("Image", "CompressedImage", "RawImage")

#: The range in which the frame rate that a video states is trusted, Hz.
_RATES = (0.5, 500.0)


@dataclass(frozen=True)
class Source:
    """The pictures of one camera.

    - path: as the user gave it
    - files: the video, the files of the bag, or the picture files in order
    - frame_id: frame id of each picture; None for a video
    - n_frames: None if the video lacks it
    - frame_rate: Hz; None for picture files and for a video without one
    - topic: of the pictures in a bag; None for other sources
    - time_s (n_frames,): when each picture in a bag was taken, seconds; None for other sources
    """

    path: str
    files: tuple[Path, ...]
    frame_id: tuple[int, ...] | None
    n_frames: int | None
    frame_rate: float | None
    topic: str | None = None
    time_s: FloatArray | None = None


def is_pattern(path: str) -> bool:
    """Whether a path is a glob pattern."""
    return any(c in path for c in "*?[") and not Path(path).exists()


def open_source(path: str | Path, topic: str | None = None) -> Source:
    """Finds the pictures at a path: a video, a picture, a folder of pictures, a glob or a bag.

    - topic: of the pictures in a bag; by default the only one that has some

    Raises InputError, naming the path, if there are none or the file is no video.
    """
    path = str(path)
    if is_pattern(path):
        return _picture_files(path, [Path(p) for p in glob.glob(path, recursive=True)])
    place = Path(path)
    if is_bag(place):
        return _pictures_in_bag(place, topic)
    if topic is not None:
        raise InputError(f"{path}: topic: only a bag has topics")
    if place.is_dir():
        return _picture_files(path, list(place.iterdir()))
    if not place.is_file():
        raise InputError(f"{path}: no such video, folder or pictures")
    if place.suffix.lower() in PICTURES:
        return _picture_files(path, [place])
    video = open_video(place)
    count, rate = video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_FPS)
    video.release()
    known_rate = float(rate) if _RATES[0] <= rate <= _RATES[1] else None
    return Source(path, (place,), None, int(count) if count > 0 else None, known_rate)


def is_bag(place: Path) -> bool:
    """Whether a path is a bag or an MCAP file."""
    is_folder = place.is_dir() and (place / "metadata.yaml").is_file()
    return is_folder or (place.is_file() and place.suffix.lower() in FORMATS["rosbag"][0])


def _pictures_in_bag(place: Path, topic: str | None) -> Source:
    chosen = image_topic(place, topic)
    time_s = stamps_of(place, chosen)
    files = files_of(place) if place.is_dir() else [place]
    ids = tuple(range(len(time_s)))
    if (np.diff(time_s) <= 0).any():
        # Stamps that do not increase are ignored.
        return Source(str(place), tuple(files), ids, len(ids), None, chosen)
    rate = rate_of(np.array(ids), time_s)
    return Source(str(place), tuple(files), ids, len(ids), rate, chosen, time_s)


def camera_of_pictures(camera: Camera, source: Source) -> Camera:
    """The camera as it takes the pictures of a source. If these have another size than it was
    calibrated for, and the same aspect ratio, it is scaled with a warning. Another warns of
    a height that no car and no lorry has.

    Raises InputError, naming the source, for pictures of another aspect ratio.
    """
    if not USUAL_HEIGHTS[0] <= camera.height_m <= USUAL_HEIGHTS[1]:
        warnings.warn(
            f"{camera.name or 'the camera'}: doubtful: {said_height(camera)}; calibrate it again",
            UserWarning,
            stacklevel=2,
        )
    _, _, first = next(images_of(source, None))
    if size_of(first) == (camera.width, camera.height):
        return camera
    with problems_in(source.path):
        resized = scaled(camera, *size_of(first))
    warnings.warn(
        f"{source.path}: its pictures have {_size(first)} pixels, {camera.name or 'the camera'} was"
        f" calibrated for {camera.width}x{camera.height}: it is scaled to them; if they were cut"
        " instead of resized, calibrate again",
        UserWarning,
        stacklevel=2,
    )
    return resized


def note_assumed_rate(source: Source, rate: float, key: str) -> None:
    """Warn that the frame rate of a source is unknown.

    - rate: what is assumed, Hz
    - key: the key that sets another
    """
    if source.frame_rate is None:
        warnings.warn(
            f"{NOTE}{source.path}: does not say its pictures per second: {rate:g} are assumed"
            f" ({key} says another)",
            UserWarning,
            stacklevel=3,
        )


def read_pictures(
    source: Source,
    camera: Camera,
    right: Source | None = None,
    frames: tuple[int, int] | None = None,
) -> Iterator[Picture]:
    """Reads the pictures in order, one at a time.

    - camera: the calibration, for the size that pictures must have
    - right: the pictures of the second camera of a stereo pair
    - frames: the first frame id to read and the one after the last; None for all

    Raises InputError, naming file and frame, for a picture that cannot be read or has another size
    than the calibration, and for two cameras with different numbers of pictures.
    """
    if right is None:
        for frame_id, file, image in images_of(source, frames):
            _check_size(file, frame_id, image, camera)
            yield Picture(frame_id, image)
        return
    for first, second in zip_longest(images_of(source, frames), images_of(right, frames)):
        if first is None or second is None:
            raise InputError(f"{source.path} and {right.path} have not equally many pictures")
        frame_id, file, image = first
        _check_size(file, frame_id, image, camera)
        _check_size(second[1], frame_id, second[2], camera)
        yield Picture(frame_id, image, second[2])


def _check_size(file: str, frame_id: int, image: Image, camera: Camera) -> None:
    if size_of(image) != (camera.width, camera.height):
        raise InputError(
            f"{file}: frame {frame_id}: the picture has {_size(image)} pixels, the camera was"
            f" calibrated for {camera.width}x{camera.height}; calibrate with pictures of this size"
        )


def _size(image: Image) -> str:
    return "x".join(map(str, size_of(image)))


def images_of(source: Source, frames: tuple[int, int] | None) -> Iterator[tuple[int, str, Image]]:
    """The frame id, file and image of each picture of one camera, of any size, one at a time.

    frames: as for `read_pictures`. Raises InputError, naming the file, for a picture that cannot be
    read, and where there is none.
    """
    images: Iterator[tuple[int, str, Image]]
    if source.topic is not None:
        found = bag_images(Path(source.path), source.topic, frames)
        images = ((frame_id, source.path, image) for frame_id, image in found)
    elif source.frame_id is None:
        found = video_images(source.path, source.files[0], source.n_frames, frames)
        images = ((frame_id, source.path, image) for frame_id, image in found)
    else:
        images = _file_images(source, frames)
    is_empty = True
    for each in images:
        is_empty = False
        yield each
    if is_empty:
        asked = "" if frames is None else f" from {frames[0]} to before {frames[1]}"
        there = f"it has {source.n_frames or 'no'} frames"
        if source.frame_id:
            there = f"its frames are {source.frame_id[0]} to {source.frame_id[-1]}"
        raise InputError(f"{source.path}: no frame{asked}; {there}")


# --- bags ------------------------------------------------------------------------------------


def image_topic(path: Path, topic: str | None) -> str:
    """The topic of the pictures, by default the only one that has some. Raises InputError where
    there is none, or several to choose from."""
    there = {
        name
        for name, (kind, _) in topics_of(path).items()
        if kind.partition(",")[0].replace(".", "/").split("/")[-1] in _KINDS
    }
    asked = {name for name in there if topic is None or name.strip("/") == topic.strip("/")}
    if len(asked) != 1:
        listed = ", ".join(sorted(there)) or "none"
        wrong = "name one as topic" if asked else f"no pictures{f' on {topic}' if topic else ''}"
        raise InputError(f"{path}: {wrong}; topics of pictures: {listed}")
    return asked.pop()


def stamps_of(path: Path, topic: str) -> FloatArray:
    """When each picture of a topic was taken, (T,), seconds."""
    return np.array([time_s for time_s, _ in messages(path, topic)])


def bag_images(
    path: Path, topic: str, frames: tuple[int, int] | None
) -> Iterator[tuple[int, Image]]:
    """The positions and pictures of a topic, as `video_images`. Raises InputError for
    a picture that cannot be read."""
    first, stop = frames or (0, None)
    for at, (_, message) in enumerate(messages(path, topic)):
        if stop is not None and at >= stop:
            return
        if at >= first:
            yield at, _decoded(message, f"{path}: picture {at} on {topic}")


def _decoded(value: Mapping[str, Any], where: str) -> Image:
    """The picture of a message, (H, W, 3), blue green red."""
    with needed("a picture in a bag", "vision"):
        from rosbags.image.image import ImageError, convert_color, to_cvtype

    data = value["data"]
    raw = np.frombuffer(base64.b64decode(data) if isinstance(data, str) else data, dtype=np.uint8)
    if "encoding" not in value:
        with silent():
            image = cv2.imdecode(raw, cv2.IMREAD_COLOR) if raw.size else None
        if image is None:
            raise InputError(f"{where}: its {value['format']!r} cannot be read")
        return image  # type: ignore[return-value]
    height, width, encoding = int(value["height"]), int(value["width"]), str(value["encoding"])
    try:
        _, _, name, channels = to_cvtype(encoding)
        kind = np.dtype(name).newbyteorder(">" if value.get("is_bigendian") else "<")
        # A row may be longer than its pixels.
        rows = raw.reshape(height, -1)[:, : width * channels * kind.itemsize]
        pixels = np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)
        image = convert_color(pixels.squeeze(axis=2) if channels == 1 else pixels, encoding, "bgr8")
    except (ImageError, ValueError, cv2.error):
        raise InputError(
            f"{where}: its encoding {encoding!r} of {width}x{height} pixels cannot be read"
        ) from None
    return image  # type: ignore[return-value]


# --- videos ----------------------------------------------------------------------------------


def open_video(path: Path) -> cv2.VideoCapture:
    """Opens a video before its first picture. Raises InputError for a file that is no video."""
    # Without this, FFmpeg prints its own lines about files that our one-line error explains.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
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
    - n_frames: as stated by the file; None if it is not
    - frames: the first position to read and the one after the last; None for all

    Warns of a video with fewer pictures than stated.
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


# --- picture files -------------------------------------------------------------------------------


def _picture_files(path: str, found: list[Path]) -> Source:
    files = sorted((p for p in found if p.suffix.lower() in PICTURES and p.is_file()), key=_natural)
    if not files:
        raise InputError(f"{path}: has no pictures ({', '.join(PICTURES)})")
    return Source(path, tuple(files), tuple(_frame_ids(files)), len(files), None)


def _natural(path: Path) -> list[tuple[int, int | str]]:
    """A sorting key that puts 9 before 10."""
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


def _frame_ids(files: list[Path]) -> list[int]:
    numbers = [[int(n) for n in re.findall(r"\d+", p.stem)] for p in files]
    if len({len(row) for row in numbers}) == 1 and len(files) > 1:
        for column in reversed(list(zip(*numbers, strict=True))):
            if all(a < b for a, b in pairwise(column)):
                # A number as large as a time in nanoseconds would lose digits as a float.
                return list(column) if column[-1] < 2**53 else list(range(len(files)))
    return list(range(len(files)))


def _file_images(
    source: Source, frames: tuple[int, int] | None
) -> Iterator[tuple[int, str, Image]]:
    assert source.frame_id is not None
    first, stop = frames or (-math.inf, math.inf)
    for frame_id, path in zip(source.frame_id, source.files, strict=True):
        if first <= frame_id < stop:
            yield frame_id, str(path), read_image(path)


def read_image(path: Path) -> Image:
    """Reads a picture file as (H, W, 3), blue green red, 8 bits each.

    Raises InputError for a file that is missing, cut off or no picture.
    """
    with silent():
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(
            f"{path}: is no picture that can be read (missing, another kind of file, or cut off)"
        )
    return image  # type: ignore[return-value]


def files_matching(pattern: str) -> list[Path]:
    """The files that match a pattern such as `boards/*.jpg`, or all files of a folder, sorted.

    Raises InputError if there are none.
    """
    if Path(pattern).is_file():
        return [Path(pattern)]
    whole = str(Path(glob.escape(pattern)) / "*") if Path(pattern).is_dir() else pattern
    found = [Path(name) for name in sorted(glob.glob(whole, recursive=True))]
    files = [path for path in found if path.is_file()]
    if not files:
        raise InputError(f"{pattern}: no file matches; give a folder or a pattern such as '*.jpg'")
    return files


def read_images(paths: Iterable[Path], skipped: list[str]) -> Iterator[tuple[Path, Image]]:
    """Reads picture files in turn; a file that is no picture is left out and reported in
    `skipped`."""
    for path in paths:
        try:
            yield path, read_image(path)
        except InputError as error:
            skipped.append(str(error))


def size_of(image: Image) -> tuple[int, int]:
    """Width and height of an image, pixels."""
    return image.shape[1], image.shape[0]
