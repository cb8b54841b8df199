"""The 2-D part of OpenLane's JSON: a folder with a file per picture (or one file),

    {"file_path": "training/segment-.../1507...00.jpg", "lane_lines": [
        {"category": 1, "uv": [[u, ...], [v, ...]], "attribute": 2, "visibility": [...], ...}]}

The categories with a solid white or yellow line, alone, double or beside a dashed one, and the two
kinds of curb are continuous. `attribute` (0 unknown, 1 left-left, 2 left, 3 right, 4 right-right)
is checked and not used: the offsets say as much. The frame number is the last number
in the name of `file_path`; OpenLane's are time stamps, which become frames of the frame rate, the
first one number 0.
"""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Any

from egolane_pgm.camera.model import Camera
from egolane_pgm.files import read_text
from egolane_pgm.recordings.image_lines import (
    ImageFrame,
    ImageLine,
    camera_of,
    check_one_drive,
    frame_numbers,
    line_log,
    points,
)
from egolane_pgm.types import InputError, LineLog

#: Category: (its name, whether it is continuous).
CATEGORIES = {
    0: ("unknown", False),
    1: ("white, dashed", False),
    2: ("white, solid", True),
    3: ("double white, dashed", False),
    4: ("double white, solid", True),
    5: ("white, left dashed, right solid", True),
    6: ("white, left solid, right dashed", True),
    7: ("yellow, dashed", False),
    8: ("yellow, solid", True),
    9: ("double yellow, dashed", False),
    10: ("double yellow, solid", True),
    11: ("yellow, left dashed, right solid", True),
    12: ("yellow, left solid, right dashed", True),
    20: ("left curb", True),
    21: ("right curb", True),
}

#: Unknown, left-left, left, right, right-right.
_N_ATTRIBUTES = 5


def read_openlane(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    camera: Camera | str | Path | None = None,
    valid: str = "hysteresis",
    frame_step: int = 1,
    ahead_m: float = 0.0,
) -> LineLog:
    """Read the 2-D lines of a folder of OpenLane's JSON files, T frames of at most L lines, left
    to right. The options are those of `read_tusimple`.

    Raises InputError, with the file, for a folder without such files, broken JSON, missing keys,
    u and v of different lengths, an unknown category, frames given twice, no camera.
    """
    path = Path(path)
    seen_by = camera_of(camera, path)
    files = [path] if path.is_file() else sorted(path.glob("*.json"))
    if not files:
        raise InputError(f"{path}: no file *.json in it; OpenLane's format is a file per picture")
    entries = [_entry(file) for file in files]
    pictures = [
        PurePosixPath(entry.get("file_path") or file.name)
        for file, entry in zip(files, entries, strict=True)
    ]
    check_one_drive([(str(file), str(p.parent)) for file, p in zip(files, pictures, strict=True)])
    numbers = frame_numbers([picture.stem for picture in pictures], frame_rate, str(path))
    frames = [
        ImageFrame(number, _lines(entry, str(file)), str(file))
        for number, file, entry in zip(numbers, files, entries, strict=True)
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


def _entry(file: Path) -> dict[str, Any]:
    text = read_text(file)
    try:
        entry = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: is not JSON: {error}") from None
    if not isinstance(entry, dict) or not isinstance(entry.get("lane_lines"), list):
        raise InputError(f"{file}: has no list lane_lines, which OpenLane's format needs")
    if not isinstance(entry.get("file_path", ""), str):
        raise InputError(f"{file}: file_path is not a text")
    return entry


def _lines(entry: dict[str, Any], source: str) -> list[ImageLine]:
    lines = []
    for k, lane in enumerate(entry["lane_lines"]):
        where = f"{source}: lane_lines {k + 1}"
        uv = lane.get("uv") if isinstance(lane, dict) else None
        if not isinstance(uv, list) or len(uv) != 2:
            raise InputError(f"{where}: uv needs a list of u and a list of v")
        u, v = points(uv[0], where, "u"), points(uv[1], where, "v")
        if len(u) != len(v):
            raise InputError(f"{where}: {len(u)} u for {len(v)} v")
        category = lane.get("category", 0)
        if type(category) is not int or category not in CATEGORIES:
            known = ", ".join(map(str, CATEGORIES))
            raise InputError(f"{where}: unknown category {category!r} (known: {known})")
        if lane.get("attribute", 0) not in range(_N_ATTRIBUTES):
            raise InputError(f"{where}: unknown attribute {lane['attribute']!r} (known: 0 to 4)")
        if len(u):
            lines.append(ImageLine(u, v, CATEGORIES[category][1]))
    return lines
