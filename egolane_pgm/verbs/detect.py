"""The verb `detect`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from egolane_pgm.recordings.columns import FRAME_RATE
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.verbs.options import (
    CameraFile,
    Frames,
    Option,
    Progress,
    StrPath,
    check_frames,
    keys_of,
    path_of,
)
from egolane_pgm.vision.camera.model import read_camera
from egolane_pgm.vision.camera.pictures import (
    camera_of_pictures,
    note_assumed_rate,
    open_source,
    read_pictures,
)
from egolane_pgm.vision.detectors.runner import check_pair, collect, find_detector
from egolane_pgm.vision.detectors.runner import detect as detect_lines

EXAMPLES = (
    "egolane detect drive.mp4 --camera cam.yaml --detector ml -o lines.parquet",
    "egolane detect 'left/*.jpg' --right 'right/*.jpg' --camera cam.yaml --detector sl"
    " -o lines.csv",
)

#: Extensions of recordings of lines that can be written.
TARGETS = (".parquet", ".csv")


def detect(
    pictures: StrPath,
    *,
    camera: CameraFile,
    detector: Annotated[StrPath, Option("NAME|FILE.py")] = "ml",
    out: Annotated[StrPath | None, Option("FILE", names=("-o",), required=True)] = None,
    right: Annotated[StrPath | None, Option("PICTURES")] = None,
    topic: str | None = None,
    frames: Frames = None,
    frame_rate: Annotated[float | None, Ge(0.1), Le(1000), Option(said="the video's")] = None,
    parameters: Annotated[
        Mapping[str, Any] | None, Option("KEY=VALUE", names=("--set",), example="lri_frames=5")
    ] = None,
    progress: Progress = None,
) -> LineLog:
    """Detect and follow lines in PICTURES: a video, a folder of pictures, a 'glob*.jpg' or a bag.

    What was detected before Ctrl-C, or before a picture that cannot be used, is written too. Then
    `egolane run FILE --n-lanes N` gives the lane.

    - camera: the camera's YAML.
    - detector: `egolane show` lists them.
    - out: where the lines go: .parquet or .csv.
    - right: those of the second camera.
    - topic: topic of the pictures in a bag.
    - frames: frame ids, STOP left out.
    - frame_rate: pictures per second; of files, 10 where nothing is said.
    - parameters: a parameter of the detector, e.g. lri_frames=5; `egolane show NAME` lists them.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns the lines, which `run` takes. Raises InputError for pictures that cannot be used, and
    whatever does not fit together.

    >>> import egolane_pgm as ego
    >>> ego.detect("drive.avi", camera="camera.yaml", frames=(10, 10))
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: frames: 10 10 is an empty range
    """
    check_frames(frames)
    target = None if out is None else _target(Path(path_of(out, "out")))
    pictures, camera = path_of(pictures, "pictures"), path_of(camera, "camera")
    given = keys_of(parameters, "parameters", "{'lri_frames': 5}")
    found = find_detector(
        path_of(detector, "detector"),
        given,
        Path.cwd(),
        "detector",
        "parameters",
    )
    of_camera = read_camera(Path(camera))
    check_pair(found, of_camera, right is not None, "right")
    left = open_source(pictures, topic)
    of_camera = camera_of_pictures(of_camera, left)
    second = open_source(path_of(right, "right")) if right is not None else None
    rate = frame_rate or left.frame_rate or FRAME_RATE
    began, total = time.perf_counter(), None if frames else left.n_frames
    seen = read_pictures(left, of_camera, second, frames)
    with bar(seen, progress, desc=found.name, unit="frame", total=total) as shows:
        lines = detect_lines(found, of_camera, shows)
        done = collect(lines, rate, pictures, None if frame_rate else left.time_s)
    if done.log is None:
        raise done.stopped or InputError(f"{pictures}: no frame")
    if done.stopped is None and frame_rate is None:
        note_assumed_rate(left, rate, "frame_rate")
    if target is None:
        if done.stopped is not None:
            raise done.stopped
        return done.log
    write_table(target, done.log)
    if isinstance(done.stopped, InputError):
        raise InputError(f"{done.stopped}; the lines of the frames before are in {target}")
    if done.stopped is not None:
        kept = f"what was detected so far is in {target}; the same command begins anew"
        raise KeyboardInterrupt(kept)
    speed = len(done.log) / max(time.perf_counter() - began, 1e-9)
    sys.stderr.write(f"{found.name}: {speed:.0f} frames/s\n")
    return done.log


def says(done: LineLog, given: Mapping[str, Any]) -> str:
    """What was found, in one line."""
    per_frame = np.isfinite(done.offset_m).sum(axis=1).mean()
    return (
        f"{given['out']}: {len(done)} frames, ids {done.frame_id[0]} to {done.frame_id[-1]};"
        f" {per_frame:.1f} lines per frame, {done.is_valid.sum(axis=1).mean():.1f} of them valid"
    )


def _target(target: Path) -> Path:
    """The file, which can be written. Raises InputError for an extension that lines are not written
    as."""
    if target.suffix.lower() not in TARGETS:
        raise InputError(f"out: {target}: lines are written as {', '.join(TARGETS)}")
    check_place(target)
    return target
