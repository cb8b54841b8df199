"""Bags of pictures in the encodings of sensor_msgs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from egolane_pgm.vision.camera.picture import Image

#: When the first picture was taken, seconds since 1970.
START_S = 1_700_000_000


def write_images(
    folder: Path,
    images: Sequence[Image],
    encoding: str = "png",
    topics: tuple[str, ...] = ("/front",),
) -> Path:
    """A ROS 2 bag of pictures, a frame each 80 ms, the eleventh 80 ms late."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic in topics:
            kind = "CompressedImage" if encoding in ("png", "jpeg", "other") else "Image"
            name = f"sensor_msgs/msg/{kind}"
            connection = bag.add_connection(topic, name, typestore=store)
            for k, image in enumerate(images):
                ms = 80 * (k + (k >= 10))
                stamp = store.types["builtin_interfaces/msg/Time"](
                    START_S + ms // 1000, ms % 1000 * 10**6
                )
                header = store.types["std_msgs/msg/Header"](stamp, "front")
                message = store.types[name](header, *fields(image, encoding))
                bag.write(connection, ms * 10**6, store.serialize_cdr(message, name))
    return folder


def fields(image: Image, encoding: str) -> tuple[Any, ...]:
    """What a message has of an image beside its header."""
    height, width = image.shape[:2]
    if encoding in ("png", "jpeg", "other"):
        data = cv2.imencode(".jpg" if encoding == "jpeg" else ".png", image)[1].ravel()
        return encoding, data if encoding != "other" else data[:9]
    pixels = {
        "bgr8": lambda: image,
        "rgb8": lambda: image[:, :, ::-1],
        "bgra8": lambda: np.dstack([image, np.full((height, width), 255, np.uint8)]),
        "mono8": lambda: image[:, :, 0],
        "mono16": lambda: image[:, :, 0].astype(">u2") * 257,
        "8UC3": lambda: image,
        "8UC2": lambda: image[:, :, :2],
        "nv12": lambda: image[:, :, 0],
    }[encoding]()
    # Rows are filled up to a multiple of 64 bytes.
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
    step = -(-rows.shape[1] // 64) * 64
    padded = np.pad(rows, ((0, 0), (0, step - rows.shape[1])))
    return height, width, encoding, int(encoding == "mono16"), step, padded.ravel()
