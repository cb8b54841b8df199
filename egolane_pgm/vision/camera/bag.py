"""Reads the pictures in a bag or an MCAP file: sensor_msgs/Image and CompressedImage, and those of
Foxglove's schemas. Their frame ids are their positions on the topic, from 0."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.recordings.topics import messages, topics_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.writing import silent

#: The message types of pictures, whatever their package.
_KINDS = ("Image", "CompressedImage", "RawImage")


def image_topic(path: Path, topic: str | None) -> str:
    """The topic of the pictures, by default the only one that has some. Raises InputError where
    there is none or nothing says which of several."""
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
    return np.array([message.time_s for message in messages(path, [topic])])


def bag_images(
    path: Path, topic: str, frames: tuple[int, int] | None
) -> Iterator[tuple[int, Image]]:
    """The positions and pictures of a topic, as `pictures.video_images`. Raises InputError for
    a picture that cannot be read."""
    first, stop = frames or (0, None)
    for at, message in enumerate(messages(path, [topic])):
        if stop is not None and at >= stop:
            return
        if at >= first:
            yield at, _decoded(message.value, f"{path}: picture {at} on {topic}")


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
