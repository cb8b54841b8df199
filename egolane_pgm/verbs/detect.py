"""The verb `detect`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from egolane_pgm.experiment import DETECTOR
from egolane_pgm.loading import load_experiment, parse_overrides
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.verbs.options import CameraFile, Option, Overrides, Progress, StrPath, path_of
from egolane_pgm.vision.camera.pictures import (
    camera_of_pictures,
    note_assumed_rate,
    read_pictures,
)
from egolane_pgm.vision.detectors.pictures import open_pictures
from egolane_pgm.vision.detectors.runner import collect
from egolane_pgm.vision.detectors.runner import detect as detect_lines

EXAMPLES = (
    "egolane detect drive.mp4 --camera cam.yaml --detector ml -o lines.parquet",
    "egolane detect 'left/*.jpg' --set recording.right='right/*.jpg' --camera cam.yaml"
    " --detector sl -o lines.csv",
)

#: Extensions of recordings of lines that can be written.
TARGETS = (".parquet", ".csv")


def detect(
    pictures: StrPath,
    *,
    camera: CameraFile,
    detector: Annotated[StrPath, Option("NAME|FILE.py")] = "ml",
    overrides: Overrides = (),
    out: Annotated[StrPath | None, Option("FILE", names=("-o",), required=True)] = None,
    progress: Progress = None,
) -> LineLog:
    """Detect and follow lines in PICTURES: a video, a folder of pictures, a 'glob*.jpg' or a bag.

    Lines found before Ctrl-C, or before a picture that cannot be read, are kept. Then
    `egolane run FILE --n-lanes N` infers the lane.

    - camera: YAML file of the camera.
    - detector: name of a detector (`egolane show` lists them), or a file.
    - overrides: a parameter of the detector, e.g. lri_frames=5, or a key of the recording: right,
      topic, frames, frame_rate, e.g. recording.frame_rate=25.
    - out: .parquet or .csv file for the lines.
    - progress: whether to show a bar; by default in a terminal.

    Returns the lines, which `run` takes. Raises InputError for pictures, keys and parameters that
    cannot be used.

    >>> import egolane_pgm as ego
    >>> ego.detect("drive.avi", camera="camera.yaml", overrides={"recording.frames": [10, 10]})
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: ...
    """
    target = None if out is None else _target(Path(path_of(out, "out")))
    keys = parse_overrides(overrides)
    recording = {
        **keys.pop("recording", {}),
        "path": path_of(pictures, "pictures"),
        "camera": path_of(camera, "camera"),
        "detector": path_of(detector, "detector"),
    }
    # The number of lanes has no effect on lines.
    experiment = load_experiment(
        {
            "name": "detect",
            "n_lanes": 1,
            "recording": recording,
            "parameters": {DETECTOR: keys},
        }
    )
    frames = experiment.recording.frames
    found, of_camera, left, right = open_pictures(experiment)
    of_camera = camera_of_pictures(of_camera, left)
    given_rate = experiment.recording.frame_rate if "frame_rate" in recording else None
    rate = given_rate or left.frame_rate or experiment.recording.frame_rate
    began, total = time.perf_counter(), None if frames else left.n_frames
    images = read_pictures(left, of_camera, right, frames)
    with bar(images, progress, desc=found.name, unit="frame", total=total) as shown:
        lines = detect_lines(found, of_camera, shown)
        done = collect(lines, rate, left.path, None if given_rate else left.time_s)
    if done.log is None:
        raise done.stopped or InputError(f"{left.path}: no frame")
    if done.stopped is None and given_rate is None:
        note_assumed_rate(left, rate, "recording.frame_rate")
    if target is None:
        if done.stopped is not None:
            raise done.stopped
        return done.log
    write_table(target, done.log)
    if isinstance(done.stopped, InputError):
        raise InputError(f"{done.stopped}; the lines of the frames before are in {target}")
    if done.stopped is not None:
        raise KeyboardInterrupt(f"the lines of the frames before are in {target}")
    speed = len(done.log) / max(time.perf_counter() - began, 1e-9)
    sys.stderr.write(f"{found.name}: {speed:.0f} frames/s\n")
    return done.log


def summary(done: LineLog, given: Mapping[str, Any]) -> str:
    """Summarize the lines in one line."""
    per_frame = np.isfinite(done.offset_m).sum(axis=1).mean()
    return (
        f"{given['out']}: {len(done)} frames, ids {done.frame_id[0]} to {done.frame_id[-1]};"
        f" {per_frame:.1f} lines per frame, {done.is_valid.sum(axis=1).mean():.1f} of them valid"
    )


def _target(target: Path) -> Path:
    """Check that lines can be written to a file. Raises InputError for another extension."""
    if target.suffix.lower() not in TARGETS:
        raise InputError(f"out: {target}: lines are written as {', '.join(TARGETS)}")
    check_place(target)
    return target
