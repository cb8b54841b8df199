"""Pictures from a pattern of names, each problem one line."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.detectors import Image
from egolane_pgm.types import InputError


def matching(pattern: str) -> list[Path]:
    """The files that match a pattern such as `boards/*.jpg`, or all files of a folder, sorted."""
    whole = str(Path(pattern) / "*") if Path(pattern).is_dir() else pattern
    found = [Path(name) for name in sorted(glob.glob(whole, recursive=True))]
    files = [path for path in found if path.is_file()]
    if not files:
        raise InputError(f"{pattern}: no file matches; give a folder or a pattern such as '*.jpg'")
    return files


def read_picture(path: Path) -> Image:
    """A picture (H, W, 3), blue green red. InputError for a file that is none."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error as error:
        # A picture of more pixels than OpenCV takes, say.
        raise InputError(f"{path}: cannot be read: {' '.join(error.err.split())}") from None
    if image is None:
        reason = "is not a picture that OpenCV can read" if path.exists() else "is missing"
        raise InputError(f"{path}: {reason}")
    return image.astype(np.uint8, copy=False)


def readable(paths: Iterable[Path], skipped: list[str]) -> Iterator[tuple[Path, Image]]:
    """Each picture in turn; those that are none are left out and reported in `skipped`."""
    for path in paths:
        try:
            yield path, read_picture(path)
        except InputError as error:
            skipped.append(str(error))


def size_of(image: Image) -> tuple[int, int]:
    """Width, height."""
    return image.shape[1], image.shape[0]
