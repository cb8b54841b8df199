"""The command `egolane detect`: pictures of a camera in, a recording of lines out."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

from egolane_pgm.camera.model import read_camera
from egolane_pgm.camera.pictures import open_source, read_pictures
from egolane_pgm.cli import options
from egolane_pgm.detectors.runner import check_pair, collect, find_detector
from egolane_pgm.detectors.runner import detect as detect_lines
from egolane_pgm.files import check_place
from egolane_pgm.recordings import write_lines
from egolane_pgm.types import InputError, LineLog

#: Extensions of recordings of lines that can be written.
_TARGETS = (".parquet", ".csv", ".bag")


@click.command()
@click.argument("pictures")
@options.camera
@click.option(
    "--detector",
    "name",
    default="ml",
    show_default=True,
    metavar="NAME|FILE.py",
    help="`egolane ls` lists them.",
)
@click.option(
    "-o",
    "--out",
    "target",
    required=True,
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Where the lines go: .parquet, .csv or .bag.",
)
@options.right
@options.frames
@options.overrides("A parameter of the detector, e.g. lri_frames=5.")
def detect(
    pictures: str,
    camera_file: str,
    name: str,
    target: str,
    right_pictures: str | None,
    frames: tuple[int, int] | None,
    overrides: tuple[str, ...],
) -> None:
    """Detect and follow lines in PICTURES: a video, a folder of pictures or a 'glob*.jpg'.

    What was detected before Ctrl-C, or before a picture that cannot be used, is written too. Then
    `egolane run X.yaml --recording FILE` gives the lane.
    """
    if Path(target).suffix.lower() not in _TARGETS:
        raise InputError(f"--out {target}: lines are written as {', '.join(_TARGETS)}")
    check_place(Path(target))
    if frames is not None and frames[0] >= frames[1]:
        raise InputError(f"--frames {frames[0]} {frames[1]}: is an empty range")
    given = options.given(overrides, "lri_frames=5").items()
    parameters = {key.removeprefix("detector_parameters."): value for key, value in given}
    detector = find_detector(
        name, parameters, Path.cwd(), "--detector", "--set detector_parameters"
    )
    camera = read_camera(camera_file)
    check_pair(detector, camera, right_pictures is not None, "--right")
    source = open_source(pictures)
    right = open_source(right_pictures) if right_pictures else None
    bar = tqdm(
        read_pictures(source, camera, right, frames),
        desc=name,
        unit="frame",
        total=None if frames else source.n_frames,
        leave=False,
        disable=None,
    )
    began = time.perf_counter()
    done = collect(detect_lines(detector, camera, bar), source.frame_rate or 10.0, pictures)
    seconds = time.perf_counter() - began
    bar.close()
    if done.log is None:
        raise done.stopped or InputError(f"{pictures}: no frame")
    _write(target, done.log)
    if isinstance(done.stopped, InputError):
        raise InputError(f"{done.stopped}; the lines of the frames before are in {target}")
    _say(target, done.log, seconds)
    if source.frame_rate is not None:
        click.echo(
            f"the video has {source.frame_rate:g} frames per second; a recording of lines does not"
            f" say so: run on it with --set recording.frame_rate={source.frame_rate:g}"
        )
    if done.stopped is not None:
        raise KeyboardInterrupt(
            f"what was detected so far is in {target}; the same command begins anew"
        )


def _write(target: str, log: LineLog) -> None:
    """Write the lines. If the disk is full or the folder gone meanwhile, write them to another
    place: they may be the work of hours."""
    try:
        write_lines(target, log)
    except InputError as error:
        try:
            other = Path(tempfile.mkdtemp(prefix="egolane-")) / Path(target).name
            write_lines(other, log)
        except (OSError, InputError):
            raise error from None
        raise InputError(f"{error}; the lines are in {other} instead") from None


def _say(target: str, log: LineLog, seconds: float) -> None:
    lines = np.isfinite(log.offset_m).sum(axis=1).mean()
    click.echo(
        f"{target}: {len(log)} frames, ids {int(log.frame_id[0])} to {int(log.frame_id[-1])};"
        f" {lines:.1f} lines per frame, {log.is_valid.sum(axis=1).mean():.1f} of them valid;"
        f" {len(log) / max(seconds, 1e-9):.0f} frames/s"
    )
