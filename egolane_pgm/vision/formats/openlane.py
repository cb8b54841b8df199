"""OpenLane's JSON: a folder with a file per picture (or folders of them, or one file),

    {"file_path": "training/segment-.../1507...00.jpg",
     "intrinsic": [3 x 3], "extrinsic": [4 x 4], "lane_lines": [
        {"category": 1, "uv": [[u, ...], [v, ...]], "xyz": [[x, ...], [y, ...], [z, ...]],
         "visibility": [...], "attribute": 2, "track_id": 3}]}

Lines that have `xyz` are taken from these, and need no camera. Else `uv`, in pixels, is taken with
the camera that is given, or, if none is, with the file's own `intrinsic` and `extrinsic`.

- Labels have `xyz` as three lists, x forward, y left and z up in the camera's frame, which
  `extrinsic` takes to the car's (OpenLane's `docs` and `eval/LANE_evaluation/README.md`, and how
  its `eval_3D_lane.py` turns them). Points whose `visibility` is 0 are left out.
- Results of detectors, as `eval_3D_lane.py` reads them, have a list of points [x, y, z], x to the
  right, y forward and z up, on the road below the camera.

The categories with a solid white or yellow line, alone, double or beside a dashed one, and the two
kinds of curb are continuous. `attribute` is not used: the offsets say as much. The frame number is
the last number in the name of `file_path`; OpenLane's are time stamps, which become frames of the
frame rate, the first one number 0. Each segment (the folder of `file_path`) is a clip of its own.
"""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from egolane_pgm.recordings import files_with
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import FloatArray, InputError, LineLog, problems_in
from egolane_pgm.vision.camera.model import Camera, camera_from_matrices, image_to_road
from egolane_pgm.vision.formats.image_lines import (
    ImageFrame,
    ImageLine,
    RoadLine,
    camera_of,
    line_log,
    points,
)

#: Categories: unknown and lines (white, yellow, double white, double yellow, each dashed, solid or
#: one of each), curbs; and those of them that are continuous.
CATEGORIES = (*range(13), 20, 21)
CONTINUOUS = (2, 4, 5, 6, 8, 10, 11, 12, 20, 21)

#: Width and height of the pictures, which the files do not say (the front camera of Waymo's cars).
PICTURE_SIZE = (1920, 1280)


def read_openlane(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    camera: Camera | str | Path | None = None,
    valid: str | None = None,
    frame_step: int = 1,
    ahead_m: float = 0.0,
) -> LineLog:
    """Read the lines of a folder of OpenLane's JSON files, T frames of at most L lines, left to
    right. The options are those of `read_tusimple`.

    - camera: for lines in pixels, where the files do not say their own; lines in metres need none.

    Raises InputError, with the file, for a folder without such files, broken JSON, missing keys,
    u and v of different lengths, an unknown category, frames given twice, and lines in pixels
    without a camera.
    """
    path = Path(path)
    files = [path] if path.is_file() else files_with(path, ".json")
    if not files:
        raise InputError(f"{path}: no file *.json in it; OpenLane's format is a file per picture")
    frames = []
    for file in files:
        entry = _entry(file)
        picture = PurePosixPath(entry.get("file_path") or file)
        own = None if camera is not None else own_camera(entry, str(file))
        lines = _lines(entry, str(file), own)
        frames.append(ImageFrame(picture.stem, lines, str(file), str(picture.parent)))
    is_in_pixels = any(isinstance(line, ImageLine) for frame in frames for line in frame.lines)
    seen_by = camera_of(camera, path) if is_in_pixels or camera is not None else None
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
    if not all(isinstance(lane, dict) for lane in entry["lane_lines"]):
        raise InputError(f"{file}: lane_lines: each line needs to be an object with uv or xyz")
    if not isinstance(entry.get("file_path", ""), str):
        raise InputError(f"{file}: file_path is not a text")
    return entry


def read_own_camera(file: str | Path, size: tuple[int, int] = PICTURE_SIZE) -> Camera:
    """The camera that a file of OpenLane's says its picture is from.

    - size: width and height of the picture, pixels

    Raises InputError, with the file, for one that does not say it.
    """
    camera = own_camera(_entry(Path(file)), str(file), size)
    if camera is None:
        raise InputError(f"{file}: has no intrinsic and extrinsic, which say what its camera is")
    return camera


def own_camera(
    entry: dict[str, Any], source: str, size: tuple[int, int] = PICTURE_SIZE
) -> Camera | None:
    """The camera of an entry; None if it does not say both matrices.

    OpenLane's `intrinsic` is the pinhole matrix of a camera with x to the right and y down, its
    `extrinsic` takes a camera frame with x forward, y left and z up to the car's (OpenLane's
    `data/Coordinate_Sys.md`).

    Raises InputError, beginning with `source`, for matrices that are no camera's.
    """
    if entry.get("intrinsic") is None or entry.get("extrinsic") is None:
        return None
    turn = _extrinsic(entry["extrinsic"], source)
    lens = _matrix(entry["intrinsic"], 3)
    if lens is None:
        raise InputError(f"{source}: intrinsic is no 3 x 3 matrix of numbers")
    with problems_in(f"{source}: intrinsic and extrinsic"):
        return camera_from_matrices(lens, turn, *size)


def _lines(entry: dict[str, Any], source: str, camera: Camera | None) -> list[ImageLine | RoadLine]:
    """The lines of an entry. camera: where it is known, brings those in pixels onto the road."""
    lines: list[ImageLine | RoadLine] = []
    for k, lane in enumerate(entry["lane_lines"]):
        where = f"{source}: lane_lines {k + 1}"
        category = lane.get("category", 0)
        if type(category) is not int or category not in CATEGORIES:
            known = ", ".join(map(str, CATEGORIES))
            raise InputError(f"{where}: unknown category {category!r} (known: {known})")
        is_continuous = category in CONTINUOUS
        if "xyz" in lane:
            x, y = _on_road(lane, entry.get("extrinsic"), where)
            lines.append(RoadLine(x, y, is_continuous))
            continue
        uv = lane.get("uv")
        if not isinstance(uv, list) or len(uv) != 2:
            raise InputError(f"{where}: uv needs a list of u and a list of v")
        u, v = points(uv[0], where, "u"), points(uv[1], where, "v")
        if len(u) != len(v):
            raise InputError(f"{where}: {len(u)} u for {len(v)} v")
        if camera is not None:
            lines.append(RoadLine(*image_to_road(camera, u, v), is_continuous))
        elif len(u):
            lines.append(ImageLine(u, v, is_continuous))
    return lines


def _on_road(lane: dict[str, Any], extrinsic: object, where: str) -> tuple[FloatArray, FloatArray]:
    """The points of a line in metres ahead of the camera and to the right of the car's middle.

    - extrinsic: (4, 4), from the camera's frame to the car's (x forward, y left, z up); None where
      the file has none.

    Raises InputError, beginning with `where`, for points of neither of the two layouts.
    """
    given = lane["xyz"]
    rows = [points(row, where, "xyz") for row in given] if isinstance(given, list) else []
    if given == [] or (rows and not any(map(len, rows))):
        return np.zeros(0), np.zeros(0)
    turn = np.eye(4) if extrinsic is None else _extrinsic(extrinsic, where)
    # Three lists of three are points or coordinates; a label is known by what it has beside.
    is_label = len(rows) == 3 and (len(rows[0]) != 3 or "uv" in lane or "visibility" in lane)
    if len({len(row) for row in rows}) != 1 or not (is_label or len(rows[0]) == 3):
        raise InputError(
            f"{where}: xyz is neither lists of x, y and z of the same length nor a list of points"
            " [x, y, z]"
        )
    values = np.array(rows)
    if not is_label:
        return values[:, 1], values[:, 0] - turn[1, 3]
    if extrinsic is None:
        raise InputError(
            f"{where}: xyz are in the camera's frame, and the file has no extrinsic, which says how"
            " the camera is turned"
        )
    seen = lane.get("visibility") or [1] * values.shape[1]
    kept = points(seen, where, "visibility") > 0
    if len(kept) != values.shape[1]:
        raise InputError(f"{where}: {len(kept)} visibility for {values.shape[1]} points")
    ahead, left, _ = turn[:3, :3] @ values[:, kept]
    return ahead, -(left + turn[1, 3])


def _extrinsic(given: object, where: str) -> FloatArray:
    matrix = _matrix(given, 4)
    # Rows of a rotation have length 1 and are at right angles.
    if matrix is None or not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-2):
        raise InputError(f"{where}: extrinsic is no 4 x 4 matrix of a turn and a shift")
    return matrix


def _matrix(given: object, size: int) -> FloatArray | None:
    """A square matrix of finite numbers, or None."""
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return matrix if matrix.shape == (size, size) and np.isfinite(matrix).all() else None
