"""The command `egolane detect`: pictures of a camera in, a recording of lines out."""

from __future__ import annotations

import click

from egolane_pgm.api.detections import check_target, detect_some
from egolane_pgm.cli import options
from egolane_pgm.recordings import write_lines
from egolane_pgm.types import InputError


@click.command()
@click.argument("pictures")
@options.camera
@click.option(
    "--detector",
    "name",
    default="ml",
    show_default=True,
    metavar="NAME|FILE.py",
    shell_complete=options.detectors,
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
@options.overrides(
    "A parameter of the detector, e.g. lri_frames=5; `egolane show NAME` lists them."
)
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
    check_target(target)
    done = detect_some(
        pictures,
        camera=camera_file,
        detector=name,
        right=right_pictures,
        frames=frames,
        overrides=options.given(overrides, "lri_frames=5"),
    )
    write_lines(target, done.log)
    if isinstance(done.stopped, InputError):
        raise InputError(f"{done.stopped}; the lines of the frames before are in {target}")
    click.echo(f"{target}: {done.title()}")
    if done.frame_rate is not None:
        click.echo(
            f"the video has {done.frame_rate:g} frames per second; a recording of lines does not"
            f" say so: run on it with --set recording.frame_rate={done.frame_rate:g}"
        )
    if done.stopped is not None:
        raise KeyboardInterrupt(
            f"what was detected so far is in {target}; the same command begins anew"
        )
