"""The commands of `egolane` about recordings: data, convert and lines."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.experiment import load_experiment
from egolane_pgm.recordings import (
    catalog,
    format_of,
    read_lines_with,
    read_with,
    takes_camera,
    write_lines,
)
from egolane_pgm.report.tables import box_text
from egolane_pgm.types import InputError


@click.group()
def data() -> None:
    """The paper's recordings: list them, download them, check them."""


@data.command("list")
def list_data() -> None:
    """What the data set consists of, and which files are there."""
    for folder in catalog.data_folders():
        click.echo(f"looked in: {folder}")
    for outcome in catalog.verify():
        file = outcome.file
        click.echo(
            f"{outcome.status:>10}  {file.size / 1e6:6.2f} MB  {catalog.BASE_URL}/{file.name}"
        )


@data.command()
@click.option("--base-url", help="A mirror that has the files under their names.")
@click.option("--folder", type=click.Path(file_okay=False), help="Where to put them.")
def fetch(base_url: str | None, folder: str | None) -> None:
    """Download what is missing; checks every sha256, keeps good files."""
    _say(catalog.fetch(base_url=base_url, folder=folder))


@data.command()
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    help="Where they are; by default as a run finds them.",
)
def verify(folder: str | None) -> None:
    """Check every file against its sha256: those in $EGOLANE_DATA, else the downloaded ones."""
    _say(catalog.verify(folder))


def have_recordings() -> bool:
    """Whether the paper's recordings are there. If not, offer to download them, or print where they
    were looked for and how to get them."""
    if _all_found():
        return True
    size = sum(file.size for file in catalog.list_files()) / 1e6
    if sys.stdin.isatty() and click.confirm(
        f"Download the paper's recordings ({size:.0f} MB) to {catalog.download_folder()}?"
    ):
        try:
            problems = catalog.problems(catalog.fetch())
        except InputError as error:
            problems = [str(error)]
        for line in problems:
            click.echo(f"egolane: {line}", err=True)
        if _all_found():
            return True
    places = " and ".join(map(str, catalog.data_folders()))
    click.echo(f"The paper's recordings (rle/*.bag) are not there; looked in {places}.")
    click.echo(
        f"To get them: `egolane data fetch` ({size:.0f} MB), or set EGOLANE_DATA to the folder that"
        " has rle/."
    )
    return False


def _all_found() -> bool:
    try:
        for file in catalog.list_files():
            catalog.find_file(file.target)
    except InputError:
        return False
    return True


def _say(outcomes: list[catalog.Outcome]) -> None:
    """Print how many files are good and what is wrong; the last message is raised as InputError."""
    good = sum(outcome.ok for outcome in outcomes)
    click.echo(f"{good} of {len(outcomes)} files are there and good")
    problems = catalog.problems(outcomes)
    for line in problems[:-1]:
        click.echo(f"egolane: {line}", err=True)
    if problems:
        raise InputError(problems[-1])


@click.command()
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path(dir_okay=False))
@click.option("--topic", help="Topic of a bag.")
@click.option("--frame-id", type=click.Choice(["way_id", "seq", "count"]), default="way_id")
@click.option("--format", "format_", metavar="NAME", help="Where the extension does not tell it.")
@click.option("--camera", metavar="FILE", help="The camera's YAML, for lines given in pixels.")
@click.option("--frame-rate", type=float, help="Frames per second.")
@options.overrides("A further option of the format, e.g. valid=always for labels.")
def convert(
    source: str,
    target: str,
    topic: str | None,
    frame_id: str,
    format_: str | None,
    camera: str | None,
    frame_rate: float | None,
    overrides: tuple[str, ...],
) -> None:
    """Convert a recording of lines to .csv, .parquet, .bag or .mcap (ROS 2).

    SOURCE is one of these, a ROS 2 bag, or what another lane detector wrote, with --camera:
    TuSimple's JSON lines, a folder of CULane's .lines.txt or of OpenLane's .json.
    """
    given = {"topic": topic, "camera": camera, "frame_rate": frame_rate}
    chosen = options.given(overrides, "valid=always") | {
        key: value for key, value in given.items() if value is not None
    }
    if frame_id != "way_id":
        chosen["frame_id"] = frame_id
    log = read_with(source, format_, chosen)
    write_lines(target, log)
    first, last = int(log.frame_id[0]), int(log.frame_id[-1])
    click.echo(f"{target}: {len(log)} frames, ids {first} to {last}")


@click.command()
@click.argument("recording", type=click.Path())
@click.option("--frame", "frame_id", type=int, required=True, help="The frame's id.")
@click.option("--camera", metavar="FILE", help="The camera's YAML, for lines given in pixels.")
@options.overrides("Override a key of the experiment.")
def lines(recording: str, frame_id: int, camera: str | None, overrides: tuple[str, ...]) -> None:
    """The lines of one frame, laid out as in the paper's Box 1.

    RECORDING is a recording of lines, or the YAML of an experiment: then its own.
    """
    if Path(recording).suffix.lower() in (".yaml", ".yml"):
        if camera is not None:
            raise InputError("--camera: an experiment names its own; --set recording.camera=FILE")
        # What reads an experiment loads numba.
        from egolane_pgm.drive import load_recording

        log = load_recording(load_experiment(recording, overrides)).log
    elif overrides:
        raise InputError("--set: goes with an experiment")
    elif camera is not None and not takes_camera(format_of(recording)):
        raise InputError(f"--camera: the lines of {recording} are in metres, they need no camera")
    else:
        log = read_lines_with(recording, camera)
    click.echo(box_text(log, frame_id))
