"""CULane's label files: a folder with a text file per picture, `00030.lines.txt`. Each line of text
is one lane line, its points as `x y x y ...` in pixels; they may lie outside of the picture.

The frame number is the last number in the file's name. CULane does not tell continuous lines:
none is. The folder is that of one clip (`driver_23_30frame/05151640_0419.MP4`), with its pictures
or without, or one with folders of clips (`driver_23_30frame`), which are run clip by clip. Its
pictures are 30 or 90 frames apart, as the driver's folder says: frame_step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egolane_pgm.recordings import files_with
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.formats.image_lines import (
    ImageFrame,
    ImageLine,
    camera_of,
    line_log,
)

ENDING = ".lines.txt"


def read_culane(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    camera: Camera | str | Path | None = None,
    valid: str | None = None,
    frame_step: int = 1,
    ahead_m: float = 0.0,
) -> LineLog:
    """Read the lines of a folder of `.lines.txt` files, or of the folders below it, T frames of at
    most L lines, left to right.

    The options are those of `read_tusimple`. An empty file is a picture without lines.

    Raises InputError, with file and line, for a folder without such files, an odd number of
    coordinates, what is no number, frames given twice, no camera.
    """
    path = Path(path)
    seen_by = camera_of(camera, path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; CULane's format is a folder of *{ENDING}")
    files = files_with(path, ENDING)
    if not files:
        raise InputError(f"{path}: no file *{ENDING} in it")
    frames = [
        ImageFrame(
            file.name.removesuffix(ENDING),
            _lines(file),
            str(file),
            file.parent.relative_to(path).as_posix(),
        )
        for file in files
    ]
    return line_log(
        frames,
        camera=seen_by,
        frame_rate=frame_rate,
        valid=valid,
        frame_step=frame_step,
        ahead_m=ahead_m,
        source=str(path),
    )


def _lines(file: Path) -> list[ImageLine]:
    lines = []
    for number, row in enumerate(read_text(file).splitlines(), start=1):
        words = row.split()
        if not words:
            continue
        where = f"{file}: line {number}"
        try:
            values = np.array([float(word) for word in words])
        except ValueError as error:
            raise InputError(f"{where}: {error}; needs 'x y x y ...'") from None
        if len(values) % 2:
            raise InputError(f"{where}: {len(values)} numbers are no pairs; needs 'x y x y ...'")
        if not np.isfinite(values).all():
            raise InputError(f"{where}: a coordinate is not finite")
        lines.append(ImageLine(values[::2], values[1::2]))
    return lines
