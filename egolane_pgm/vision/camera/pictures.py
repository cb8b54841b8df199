"""Reads the pictures of a drive from a video, a folder, a glob or a bag, for one camera or for two.

The frame id of a picture in a video or a bag is its position, from 0. Picture files are taken in
natural order (`img_9.jpg` before `img_10.jpg`). Their frame ids are the last number of the names
that increases from file to file; if there is none, their positions, from 0. Only one picture is in
memory at a time.

OpenCV gives all pictures of a video in the size of the first one. It also leaves out pictures that
cannot be decoded or were never recorded: such a loss is noticed by the number of pictures in the
file's header. A picture that is decoded in part looks like any other to OpenCV.
"""

from __future__ import annotations

import base64
import glob
import math
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.recordings import FORMATS, PICTURES
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.topics import messages, topics_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError, problems_in
from egolane_pgm.vision.camera.model import USUAL_HEIGHTS, Camera, said_height, scaled
from egolane_pgm.vision.camera.picture import Image, Picture, check_size
from egolane_pgm.vision.camera.writing import silent

#: The first bytes of a JPEG and of a PNG, and the marks of its data and of its end.
_ENDS = {b"\xff\xd8": (b"\xff\xda", b"\xff\xd9"), b"\x89PNG": (b"IDAT", b"IEND")}

#: So many pictures in a row that cannot be decoded are taken for the end of a video.
_MOST_FAILED = 250

#: The message types of pictures in a bag, in any package.
_KINDS = ("Image", "CompressedImage", "RawImage")

#: The range in which the frame rate that a video states is trusted, Hz.
_RATES = (0.5, 500.0)


#: The frame rate of most videos, Hz.
_USUAL_RATE = 25

#: Reads a picture; raises InputError for a damaged one.
Load = Callable[[], Image]

#: Pictures, one at a time: frame id, file (for messages), and the function that reads it.
Numbered = Iterator[tuple[int, str, Load]]

#: Finds the pictures with frame ids from the first number to before the second.
Reader = Callable[[int, float], Numbered]


@dataclass(frozen=True)
class Source:
    """The pictures of one camera.

    - path: as the user gave it
    - read: the reader of its pictures
    - n_frames: None if the video lacks it
    - frame_rate: Hz; None for picture files and if a video has no frame rate
    - stamps: the time stamp of each picture in a bag, and of each of a video that was read so far,
      seconds, by frame id
    - seek: reads the pictures of a video near some positions: file and function for each image
    """

    path: str
    read: Reader
    n_frames: int | None
    frame_rate: float | None = None
    stamps: dict[int, float] = field(default_factory=dict)
    seek: Callable[[Iterable[int]], Iterator[tuple[str, Load]]] | None = None


def is_pattern(path: str) -> bool:
    """Whether a path is a glob pattern."""
    return any(c in path for c in "*?[") and not Path(path).exists()


def open_source(path: str | Path, topic: str | None = None) -> Source:
    """Find the pictures at a path: a video, a picture, a folder of pictures, a glob or a bag.

    - topic: of the pictures in a bag; by default the only one that has some

    Raises InputError, naming the path, if there are none or the file is not a video.
    """
    path = str(path)
    place = Path(path)
    if is_bag(place):
        return _pictures_in_bag(place, topic)
    if topic is not None:
        raise InputError(f"{path}: topic: only a bag has topics")
    if place.is_file() and place.suffix.lower() not in PICTURES:
        return _pictures_in_video(place)
    files = picture_files(path)
    ids = _frame_ids(files)

    def read(first: int, stop: float) -> Numbered:
        for frame_id, file in zip(ids, files, strict=True):
            if first <= frame_id < stop:
                yield frame_id, str(file), partial(read_image, file)

    return Source(path, read, len(ids))


def spread(source: Source, most: int) -> Iterator[tuple[str, Load]]:
    """Up to `most` pictures, evenly spread over a drive: the file of each and a function that reads
    it. A video without a number of frames is taken from its beginning."""
    n = source.n_frames or most * _USUAL_RATE
    chosen = sorted({(2 * k + 1) * n // (2 * most) for k in range(most)})
    if source.seek is not None:
        return source.seek(chosen)
    numbered = enumerate(source.read(0, math.inf))
    return ((file, load) for at, (_, file, load) in numbered if at in chosen)


def first_size(source: Source) -> tuple[int, int]:
    """Width and height of the first picture that can be read."""
    _, _, (first,) = next(images_of((source,), None))
    return size_of(first)


def camera_of_pictures(camera: Camera, source: Source) -> Camera:
    """Scale a camera to the pictures of a source, with a warning if they have another size than it
    was calibrated for, and the same aspect ratio. Another warns of a height that no car and no
    lorry has.

    Raises InputError, naming the source, for pictures of another aspect ratio.
    """
    if not USUAL_HEIGHTS[0] <= camera.height_m <= USUAL_HEIGHTS[1]:
        warnings.warn(
            f"{camera.name or 'the camera'}: doubtful: {said_height(camera)}; calibrate it again",
            stacklevel=2,
        )
    width, height = first_size(source)
    if (width, height) == (camera.width, camera.height):
        return camera
    with problems_in(source.path):
        resized = scaled(camera, width, height)
    warnings.warn(
        f"{source.path}: its pictures have {width}x{height} pixels, {camera.name or 'the camera'}"
        f" was calibrated for {camera.width}x{camera.height}: it is scaled to them; if they were"
        " cut instead of resized, calibrate again",
        stacklevel=2,
    )
    return resized


def read_pictures(
    source: Source,
    camera: Camera,
    right: Source | None = None,
    frames: tuple[int, int] | None = None,
) -> Iterator[Picture]:
    """Read the pictures in order, one at a time; see `images_of`.

    - camera: the calibration, for the size that pictures must have
    - right: the pictures of the second camera of a stereo pair
    - frames: the first frame id to read and the end, which is not read; None for all

    Raises InputError, naming file and frame, for a picture of another size than the calibration.
    """
    for frame_id, files, images in images_of((source, right) if right else (source,), frames):
        for file, image in zip(files, images, strict=True):
            with problems_in(f"{file}: frame {frame_id}"):
                check_size(image, camera.width, camera.height)
        yield Picture(frame_id, *images)


def images_of(
    sources: Sequence[Source], frames: tuple[int, int] | None
) -> Iterator[tuple[int, tuple[str, ...], tuple[Image, ...]]]:
    """The frame id, files and images of the pictures of one or two cameras, of any size, one frame
    at a time. Frames with a damaged picture are left out with a warning at the end.

    frames: as for `read_pictures`. Raises InputError if there are none, if all are damaged, and for
    two cameras with different numbers of pictures.
    """
    source = sources[0]
    n_read = 0
    damaged: list[InputError] = []
    for taken in zip_longest(*(each.read(*(frames or (0, math.inf))) for each in sources)):
        if None in taken:
            paths = " and ".join(each.path for each in sources)
            raise InputError(f"{paths} have not equally many pictures")
        try:
            images = tuple(load() for _, _, load in taken)
        except InputError as error:
            damaged.append(error)
            continue
        n_read += 1
        yield taken[0][0], tuple(file for _, file, _ in taken), images
    if damaged and not n_read:
        raise damaged[0]
    if not n_read:
        asked = "" if frames is None else f" from {frames[0]} to before {frames[1]}"
        known = f"it has {source.n_frames or 'no'} frames (pictures are numbered as in their names)"
        raise InputError(f"{source.path}: no frame{asked}; {known}")
    if damaged:
        warnings.warn(
            f"{source.path}: left out {len(damaged)} of {n_read + len(damaged)} frames whose"
            f" picture cannot be read, first {damaged[0]}",
            stacklevel=2,
        )


# --- bags ------------------------------------------------------------------------------------


def is_bag(place: Path) -> bool:
    """Whether a path is a bag or an MCAP file."""
    is_folder = place.is_dir() and (place / "metadata.yaml").is_file()
    return is_folder or (place.is_file() and place.suffix.lower() in FORMATS["rosbag"][0])


def _pictures_in_bag(place: Path, topic: str | None) -> Source:
    chosen = image_topic(place, topic)
    time_s = np.array([time_s for time_s, _ in messages(place, chosen)])

    def read(first: int, stop: float) -> Numbered:
        for at, (_, message) in enumerate(messages(place, chosen)):
            if at >= stop:
                return
            if at >= first:
                where = f"{place}: picture {at} on {chosen}"
                yield at, str(place), partial(_decoded, message, where)

    if (np.diff(time_s) <= 0).any():
        # Stamps that do not increase are ignored.
        return Source(str(place), read, len(time_s))
    rate = rate_of(np.arange(len(time_s)), time_s)
    return Source(str(place), read, len(time_s), rate, dict(enumerate(time_s.tolist())))


def image_topic(path: Path, topic: str | None) -> str:
    """The topic of the pictures, by default the only one that has some. Raises InputError if
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


def _decoded(value: Mapping[str, Any], where: str) -> Image:
    """The picture of a message, (H, W, 3), blue green red."""
    with needed("a picture in a bag", "vision"):
        from rosbags.image.image import ImageError, convert_color, to_cvtype

    data = value["data"]
    raw = np.frombuffer(base64.b64decode(data) if isinstance(data, str) else data, dtype=np.uint8)
    if "encoding" not in value:
        compressed = decoded(raw.tobytes())
        if compressed is None:
            raise InputError(f"{where}: its {value['format']!r} cannot be read")
        return compressed
    height = int(value["height"])
    width = int(value["width"])
    encoding = str(value["encoding"])
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
    """Open a video before its first picture. Raises InputError for another file."""
    # Without this, FFmpeg prints its own lines about files that our one-line error explains.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # FFmpeg takes the text before a colon for a protocol, unless the path is absolute.
    absolute = os.path.abspath(path)
    video = cv2.VideoCapture(absolute)
    if not video.isOpened() or not video.grab():
        video.release()
        raise InputError(
            f"{path}: is not a video that can be read (another kind of file, or cut off before its"
            " index was written)"
        )
    video.release()
    return cv2.VideoCapture(absolute)


def _pictures_in_video(path: Path) -> Source:
    """The pictures of a video; reading warns of fewer than the file states."""
    video = open_video(path)
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    rate = video.get(cv2.CAP_PROP_FPS)
    video.release()
    known_rate = float(rate) if _RATES[0] <= rate <= _RATES[1] else None
    stamps: dict[int, float] = {}

    def read(first: int, stop: float) -> Numbered:
        video = open_video(path)
        at = 0
        # Pictures that could not be decoded, before the next good one and in all.
        failed = 0
        lost = 0
        try:
            while at < stop and failed < _MOST_FAILED:
                if not video.grab():
                    failed += 1
                    continue
                lost += failed
                failed = 0
                if at >= first:
                    is_there, image = video.retrieve()
                    if not is_there:
                        break
                    stamps[at] = video.get(cv2.CAP_PROP_POS_MSEC) / 1000
                    yield at, str(path), partial(np.asarray, image)
                at += 1
        finally:
            video.release()
        # OpenCV counts one picture too many in some whole files.
        if first < at < min(count - (lost == 0), stop):
            warnings.warn(
                f"{path}: has {at} of the {count} frames that it should have (cut off, damaged,"
                " or dropped when it was recorded): after such a place the frame ids are too low,"
                " and the times are right",
                stacklevel=2,
            )

    def seek(positions: Iterable[int]) -> Iterator[tuple[str, Load]]:
        video = open_video(path)
        for at in positions:
            video.set(cv2.CAP_PROP_POS_FRAMES, at)
            is_there, image = video.read()
            if is_there:
                yield str(path), partial(np.asarray, image)
        video.release()

    n_frames = count if count > 0 else None
    return Source(str(path), read, n_frames, known_rate, stamps=stamps, seek=seek)


# --- picture files -------------------------------------------------------------------------------


def picture_files(path: str) -> list[Path]:
    """The picture files that a path names, in natural order: a file, a folder or a glob.

    Raises InputError if there are none.
    """
    place = Path(path)
    if is_pattern(path):
        found = [Path(name) for name in glob.glob(path, recursive=True)]
    elif place.exists():
        found = list(place.iterdir()) if place.is_dir() else [place]
    else:
        raise InputError(f"{path}: no such video, folder or pictures")
    files = sorted((p for p in found if p.suffix.lower() in PICTURES and p.is_file()), key=_natural)
    if not files:
        raise InputError(f"{path}: has no pictures ({', '.join(PICTURES)})")
    return files


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


def read_image(path: Path) -> Image:
    """Read a picture file as (H, W, 3), blue green red, 8 bits each.

    Raises InputError for a file that is missing, cut off or no picture.
    """
    raw = path.read_bytes() if path.is_file() else b""
    image = decoded(raw)
    if image is None:
        raise InputError(
            f"{path}: is not a picture that can be read (missing, another kind of file, or cut off)"
        )
    return image


def decoded(raw: bytes) -> Image | None:
    """The picture in the bytes of a file, (H, W, 3), blue green red; None if there is none. The end
    of a file that was cut off is missing, and OpenCV would fill up the picture with grey."""
    for magic, (part, end) in _ENDS.items():
        if raw.startswith(magic) and raw.rfind(end) < raw.rfind(part):
            return None
    with silent():
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR) if raw else None
    return image  # type: ignore[return-value]


def size_of(image: Image) -> tuple[int, int]:
    """Width and height of an image, pixels."""
    return image.shape[1], image.shape[0]
