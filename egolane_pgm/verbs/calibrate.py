"""The verb `calibrate`: chessboards and roads in, a camera's YAML out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.options import Option, StrPath, Target
from egolane_pgm.types import InputError
from egolane_pgm.vision.calibration.chessboard import calibrate_lens, describe_lens
from egolane_pgm.vision.calibration.road_lines import (
    ASSUMED_LANE_M,
    ASSUMED_LENS,
    assumed_camera,
    calibrate_road,
)
from egolane_pgm.vision.camera.model import Camera, read_camera, write_camera
from egolane_pgm.vision.camera.pictures import first_size, open_source, picture_files

EXAMPLES = (
    "egolane calibrate drive.mp4 -o cam.yaml",
    "egolane calibrate 'road/*.jpg' --chessboards 'boards/*.jpg' --lane-width 3.7 -o cam.yaml",
)


def calibrate(
    pictures: StrPath,
    *,
    lane_width: Annotated[float, Option("M")] = ASSUMED_LANE_M,
    chessboards: Annotated[str | None, Option("GLOB")] = None,
    board: Annotated[tuple[int, int], Option("COLUMNS ROWS")] = (9, 6),
    roll: Annotated[float, Option("DEGREES")] = 0.0,
    ignore: Annotated[Sequence[tuple[int, int, int, int]], Option("LEFT TOP RIGHT BOTTOM")] = (),
    out: Target = None,
) -> Camera:
    """Calibrate a camera: lens from chessboards, angles and height from the lines of a road.

    PICTURES of the road are a video, a folder of pictures, a 'glob*.jpg' or a bag; up to 30 of
    them, evenly spread, are used.

    - lane_width: width of the lanes of that road, metres; the height is proportional to it.
    - chessboards: pictures of a chessboard, for the lens; or a camera file of ROS, OpenCV or
      Kalibr.
    - board: inner corners of the chessboard.
    - roll: roll of the camera, clockwise.
    - ignore: pixels that never show road (mirror, dashboard); kept in the YAML. Repeatable.
    - out: the camera's YAML.

    Without chessboards a horizontal field of view of 62 degrees is assumed. Add `lateral_m`, and
    `baseline_m` of a stereo pair, to the YAML.

    Returns the camera. Raises InputError for options and pictures that cannot be used.
    """
    if out is not None:
        check_place(Path(out))

    source = open_source(str(pictures))
    size = first_size(source)
    camera = assumed_camera(*size)
    comment = [ASSUMED_LENS]
    if chessboards and Path(chessboards).suffix.lower() in (".yaml", ".yml", ".xml"):
        camera = read_camera(chessboards, height_m=1.0)
        comment = [f"Lens: from {chessboards}."]
    elif chessboards:
        lens = calibrate_lens(picture_files(chessboards), *board)
        for line in lens.skipped:
            warnings.warn(f"skipped: {line}", UserWarning, stacklevel=2)
        camera = lens.camera
        comment = [describe_lens(lens, "x".join(map(str, board)))]
    if (camera.width, camera.height) != size:
        raise InputError(
            f"the chessboards are {camera.width}x{camera.height}, the road's pictures"
            f" {size[0]}x{size[1]}; both must come from one camera, uncropped"
        )
    for mask in ignore:
        if mask[0] >= camera.width or mask[1] >= camera.height:
            text = " ".join(map(str, mask))
            raise InputError(f"ignore: {text} is not in a picture of {size[0]}x{size[1]}")
    camera = replace(camera, roll_deg=roll, ignore=tuple(ignore), lane_width_m=lane_width)
    camera, about = calibrate_road(source, camera)
    if out is not None:
        made = ["Made by `egolane calibrate`.", *comment, about]
        write_camera(Path(out), camera, "\n".join(made))
    return camera


def summary(done: Camera, given: Mapping[str, Any]) -> str:
    """Return the comment of the camera's YAML, and its path."""
    lines = Path(given["out"]).read_text(encoding="utf-8").splitlines()
    comment = [line.removeprefix("# ") for line in lines if line.startswith("# ")]
    return "\n".join([*comment[1:], f"written to {given['out']}"])
