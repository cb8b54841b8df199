"""Pictures from a pattern of names, each problem one line."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator
from pathlib import Path

from egolane_pgm.camera.pictures import read_image
from egolane_pgm.detectors import Image
from egolane_pgm.types import InputError


def matching(pattern: str) -> list[Path]:
    """The files that match a pattern such as `boards/*.jpg`, or all files of a folder, sorted."""
    if Path(pattern).is_file():
        return [Path(pattern)]
    whole = str(Path(glob.escape(pattern)) / "*") if Path(pattern).is_dir() else pattern
    found = [Path(name) for name in sorted(glob.glob(whole, recursive=True))]
    files = [path for path in found if path.is_file()]
    if not files:
        raise InputError(f"{pattern}: no file matches; give a folder or a pattern such as '*.jpg'")
    return files


def read_picture(path: Path) -> Image:
    """A picture (H, W, 3), blue green red. InputError for a file that is none."""
    if not path.exists():
        raise InputError(f"{path}: is missing")
    return read_image(path)


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
