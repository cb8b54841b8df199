"""The verb `detect`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from egolane_pgm.experiment import DETECTOR
from egolane_pgm.loading import load_experiment, parse_overrides
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.options import Option, Overrides, StrPath, Target
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision.detectors.pictures import detect_pictures

EXAMPLES = (
    "egolane detect drive.mp4 -o lines.parquet",
    "egolane detect 'left/*.jpg' --set recording.right='right/*.jpg' --camera cam.yaml"
    " --detector sl -o lines.csv",
)

#: Extensions of recordings of lines that can be written.
TARGETS = (".parquet", ".csv")


def detect(
    pictures: StrPath,
    *,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    detector: Annotated[StrPath, Option("NAME|FILE.py")] = "ml",
    overrides: Overrides = (),
    out: Target = None,
) -> LineLog:
    """Detect and follow lines in PICTURES: a video, a folder of pictures, a 'glob*.jpg' or a bag.

    Lines found before Ctrl-C, or before a picture that cannot be read, are kept. Then
    `egolane run FILE --n-lanes N` infers the lane.

    - camera: YAML file of the camera; by default PICTURES.camera.yaml, made if it does not exist.
    - detector: name of a detector (`egolane show` lists them), or a file.
    - overrides: a parameter of the detector, e.g. lri_frames=5, or a key of the recording: right,
      topic, frames, frame_rate, e.g. recording.frame_rate=25.
    - out: .parquet or .csv file for the lines.

    Returns the lines, which `run` takes. Raises InputError for pictures, keys and parameters that
    cannot be used.

    >>> import egolane_pgm as ego
    >>> ego.detect("drive.avi", camera="camera.yaml", overrides={"recording.frames": [10, 10]})
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: ...
    """
    if out is not None:
        if Path(out).suffix.lower() not in TARGETS:
            raise InputError(f"out: {out}: lines are written as {', '.join(TARGETS)}")
        check_place(Path(out))
    keys = parse_overrides(overrides)
    recording = keys.pop("recording", {})
    recording |= {"path": pictures, "detector": detector} | ({"camera": camera} if camera else {})
    # The number of lanes has no effect on lines.
    content = {"name": "detect", "n_lanes": 1, "recording": recording}
    experiment = load_experiment({**content, "parameters": {DETECTOR: keys}})
    log, stopped, _ = detect_pictures(experiment, stamps=False)
    if out is not None:
        write_table(Path(out), log)
        if isinstance(stopped, InputError):
            raise InputError(f"{stopped}; the lines of the frames before are in {out}")
        if stopped is not None:
            raise KeyboardInterrupt(f"the lines of the frames before are in {out}")
    elif stopped is not None:
        raise stopped
    return log


def summary(done: LineLog, given: Mapping[str, Any]) -> str:
    """Summarize the lines in one line."""
    per_frame = np.isfinite(done.offset_m).sum(axis=1).mean()
    return (
        f"{given['out']}: {len(done)} frames, ids {done.frame_id[0]} to {done.frame_id[-1]};"
        f" {per_frame:.1f} lines per frame, {done.is_valid.sum(axis=1).mean():.1f} of them valid"
    )
