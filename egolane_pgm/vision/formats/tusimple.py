"""TuSimple's JSON lines, which most lane detection networks can write: one picture per line,

    {"raw_file": "clips/0313-1/6040/20.jpg", "lanes": [[-2, 632, ...], ...],
     "h_samples": [240, ...]}

`lanes` has, per line, its column in each of the rows `h_samples`, negative where it is absent. In
results as the benchmark takes them, with `run_time` but no `h_samples`, these are its own 48 or 56
rows.
`classes` is optional and has the class of each line; 2 (solid white) and 4 (solid yellow) are
continuous unless the option `continuous` says otherwise. (6, a double white line, is not by
default: another lane lies beyond it, and the flag is evidence of the road's edge.)

What is a drive follows from the folders. `clips/0313-1/6040/20.jpg` and others whose folder is a
count and has one picture of the file are frames of one drive: frame 6040 of 0313-1. Any other
folder is a clip of its own, as `clips/0530/1492626047222176976_0` of the official test labels,
which have one picture (20.jpg) of each of 2,782 clips; results may have all twenty. The frame
number is then the last number in the picture's name (`frame_00042.jpg`: 42). Pictures may come in
any order.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from egolane_pgm.recordings import known_formats
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.formats.image_lines import (
    COUNT_DIGITS,
    ImageFrame,
    ImageLine,
    camera_of,
    line_log,
    points,
)

#: The rows of the benchmark's pictures (1280 x 720), by their number; its results lack h_samples.
_ROWS = {48: list(range(240, 720, 10)), 56: list(range(160, 720, 10))}

#: The largest class of the sets of classes that are in use.
_LARGEST_CLASS = 20


def read_tusimple(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    camera: Camera | str | Path | None = None,
    valid: str | None = None,
    frame_step: int = 1,
    ahead_m: float = 0.0,
    continuous: Collection[int] = (2, 4),
) -> LineLog:
    """Read the lines of a TuSimple label or result file, T frames of at most L lines.

    - frame_rate: frames per second, counted in frame ids.
    - camera: the camera of the pictures, or its YAML file.
    - valid: "hysteresis" (a line becomes valid once it is seen in ten pictures, as in the paper) or
      "always", for a source that is trusted, such as labels. By default it is hysteresis, and
      always for clips of which none has ten pictures.
    - frame_step: the difference between the numbers of neighbouring frames; frame id is number over
      frame_step.
    - ahead_m: how far ahead of the camera offsets are measured, metres; a car that steers to the
      left is there before it is at the camera.
    - continuous: the classes that are continuous lines.

    Raises InputError, with the line of the file, for broken JSON, missing keys, rows and columns
    that do not match, unknown classes, frames given twice, no camera, no frame.
    """
    path = Path(path)
    entries = list(read_entries(path))
    seen_by = camera_of(camera, path)
    solid = _classes(continuous, path)
    drives = _drives_and_names([entry["raw_file"] for _, entry in entries])
    frames = [
        ImageFrame(name, entry_lines(entry, where, solid), where, drive)
        for (drive, name), (where, entry) in zip(drives, entries, strict=True)
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


def read_entries(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """The place in the file, for messages, and the entry of each picture. Raises InputError, naming
    the place, for a line that is no entry."""
    others = f" (formats: {known_formats()})"
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        where = f"{path}: line {number}"
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{where}: is not JSON, which TuSimple's format needs in each line: {error}{others}"
            ) from None
        for key in ("raw_file", "lanes"):
            if not isinstance(entry, dict) or key not in entry:
                raise InputError(f"{where}: has no {key}, which TuSimple's format needs{others}")
        if not isinstance(entry["raw_file"], str) or not isinstance(entry["lanes"], list):
            raise InputError(f"{where}: raw_file must be a text and lanes a list of lists")
        if "h_samples" not in entry:
            entry["h_samples"] = _rows_of(entry["lanes"], where)
        others = ""  # The file is TuSimple's, with a line that is not.
        yield where, entry


def _rows_of(lanes: list[Any], where: str) -> list[int]:
    """The rows of a result that does not say them: the benchmark's, by how many there are."""
    counts = {len(lane) if isinstance(lane, list) else -1 for lane in lanes}
    if not counts <= set(_ROWS) or len(counts) > 1:
        raise InputError(
            f"{where}: has no h_samples, which TuSimple's format needs unless each lane has"
            f" {' or '.join(map(str, _ROWS))} values"
        )
    return _ROWS[counts.pop()] if counts else []


def _drives_and_names(raw_files: list[str]) -> list[tuple[str, str]]:
    """Of each picture the folder of its drive, and the part of the name with the frame number."""
    pictures = [PurePosixPath(raw_file) for raw_file in raw_files]
    held = Counter(picture.parent for picture in set(pictures))
    return [
        (str(folder.parent), folder.name)
        if folder.name.isdecimal() and len(folder.name) <= COUNT_DIGITS and held[folder] == 1
        else (str(folder), picture.stem)
        for picture, folder in ((picture, picture.parent) for picture in pictures)
    ]


def entry_lines(
    entry: dict[str, Any], where: str, solid: frozenset[int] = frozenset()
) -> list[ImageLine]:
    """The lines of a picture's entry that have at least one point.

    - solid: the classes that are continuous.

    Raises InputError as `read_tusimple` does.
    """
    rows = points(entry["h_samples"], where, "h_samples")
    classes = entry.get("classes")
    if classes is not None and (
        not isinstance(classes, list) or len(classes) != len(entry["lanes"])
    ):
        raise InputError(
            f"{where}: classes needs one class for each of {len(entry['lanes'])} lanes"
        )
    lines = []
    for k, lane in enumerate(entry["lanes"]):
        columns = points(lane, where, f"lane {k + 1}")
        if len(columns) != len(rows):
            raise InputError(
                f"{where}: lane {k + 1} has {len(columns)} values for {len(rows)} h_samples"
            )
        known = 0 if classes is None else classes[k]
        if isinstance(known, bool) or known not in range(_LARGEST_CLASS + 1):
            raise InputError(
                f"{where}: lane {k + 1} has class {known!r}, not one of 0 to {_LARGEST_CLASS}"
            )
        is_there = columns >= 0
        if is_there.any():
            lines.append(ImageLine(columns[is_there], rows[is_there], known in solid))
    return lines


def _classes(continuous: Collection[int], path: Path) -> frozenset[int]:
    given = list(continuous) if isinstance(continuous, (list, tuple, set, frozenset)) else [None]
    if not all(type(c) is int and 0 <= c <= _LARGEST_CLASS for c in given):
        raise InputError(
            f"{path}: continuous: {continuous!r} is not a list of classes, 0 to {_LARGEST_CLASS}"
        )
    return frozenset(c for c in given if c is not None)
