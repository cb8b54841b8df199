"""The commands of `egolane` about recordings: data, convert, simulate, online."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click


@click.group()
def data() -> None:
    """The paper's recordings: list them, download them, check them."""


@data.command("list")
def list_data() -> None:
    """What the data set consists of, and which files are there."""
    from egolane_pgm.recordings import catalog

    data = os.environ.get("EGOLANE_DATA")
    folders = [Path(data).expanduser()] if data else []
    folders.append(catalog.download_folder())
    # As a run finds them: the first folder that has a file counts.
    state: dict[str, str] = {}
    for folder in folders:
        click.echo(f"looked in: {folder}")
        for outcome in catalog.verify(folder):
            if state.get(outcome.file.name, "missing") == "missing":
                state[outcome.file.name] = outcome.status
    for file in catalog.list_files():
        click.echo(
            f"{state[file.name]:>10}  {file.size / 1e6:6.2f} MB  {catalog.BASE_URL}/{file.name}"
        )


@data.command()
@click.option("--base-url", help="A mirror that has the files under their names.")
@click.option("--folder", type=click.Path(file_okay=False), help="Where to put them.")
@click.option("--jobs", type=click.IntRange(1, 16), default=4, show_default=True)
def fetch(base_url: str | None, folder: str | None, jobs: int) -> None:
    """Download what is missing; resumes, checks every sha256, keeps good files."""
    from egolane_pgm.recordings import catalog
    from egolane_pgm.types import InputError

    outcomes = catalog.fetch(base_url=base_url, folder=folder, jobs=jobs)
    problems = catalog.problems(outcomes)
    click.echo(f"{len(outcomes) - len(problems)} of {len(outcomes)} files are there and good")
    _fail(problems, InputError)


@data.command()
@click.option("--folder", type=click.Path(file_okay=False), help="Where they are.")
def verify(folder: str | None) -> None:
    """Check every downloaded file against its sha256."""
    from egolane_pgm.recordings import catalog
    from egolane_pgm.types import InputError

    outcomes = catalog.verify(folder)
    problems = catalog.problems(outcomes)
    click.echo(f"{len(outcomes) - len(problems)} of {len(outcomes)} files are there and good")
    _fail(problems, InputError)


def have_recordings() -> bool:
    """Whether the paper's recordings are at hand, after an offer to download them; if not, it has
    been said in two lines what was looked for and how to get them."""
    from egolane_pgm.recordings import catalog
    from egolane_pgm.types import InputError

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
    places = [os.environ.get("EGOLANE_DATA", ""), str(catalog.download_folder())]
    click.echo(
        "The paper's recordings (rle/*.bag) are not there; looked in"
        f" {' and '.join(place for place in places if place)}."
    )
    click.echo(
        f"To get them: `egolane data fetch` ({size:.0f} MB), or set EGOLANE_DATA to the folder that"
        " has rle/."
    )
    return False


def _all_found() -> bool:
    from egolane_pgm.recordings import catalog
    from egolane_pgm.types import InputError

    try:
        for file in catalog.list_files():
            catalog.find_file(file.target)
    except InputError:
        return False
    return True


def _fail(problems: list[str], error: type[Exception]) -> None:
    for line in problems[:-1]:
        click.echo(f"egolane: {line}", err=True)
    if problems:
        raise error(problems[-1])


@click.command()
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path(dir_okay=False))
@click.option("--topic", help="Topic of a bag.")
@click.option("--frame-id", type=click.Choice(["way_id", "seq"]), default="way_id")
@click.option("--format", "format_", metavar="NAME", help="Where the extension does not tell it.")
@click.option("--camera", metavar="FILE", help="The camera's YAML, for lines given in pixels.")
@click.option("--frame-rate", type=float, help="Frames per second.")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="A further option of the format, e.g. valid=always for labels.",
)
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
    """Convert a recording of lines to .bag, .csv or .parquet.

    SOURCE is one of these, or what another lane detector wrote, with --camera: TuSimple's JSON
    lines, a folder of CULane's .lines.txt or of OpenLane's .json.
    """
    from egolane_pgm.recordings import read_with, write_lines

    given = {"topic": topic, "camera": camera, "frame_rate": frame_rate}
    options = _given(overrides, "valid=always") | {
        key: value for key, value in given.items() if value is not None
    }
    if frame_id != "way_id":
        options["frame_id"] = frame_id
    log = read_with(source, format_, options)
    write_lines(target, log)
    first, last = int(log.frame_id[0]), int(log.frame_id[-1])
    click.echo(f"{target}: {len(log)} frames, ids {first} to {last}")


def _given(overrides: tuple[str, ...], example: str) -> dict[str, Any]:
    """The keys and values of --set."""
    from egolane_pgm.experiment import read_override

    return dict(read_override(override, example) for override in overrides)


@click.command()
@click.argument("preset", default="quickstart")
@click.option("--out", type=click.Path(file_okay=False), required=True, metavar="DIR")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--n-lanes", type=int)
@click.option("--frames", type=int, help="Length of the drive.")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value of the preset's world or detector; with --images world or failures.",
)
@click.option("--images", is_flag=True, help="Render pictures instead of lines.")
@click.option("--stereo", is_flag=True, help="With --images: of two cameras.")
@click.option("--video", is_flag=True, help="With --images: as MP4 instead of JPEG files.")
@click.option("--png", is_flag=True, help="With --images: PNG, exact and large, instead of JPEG.")
def simulate(
    preset: str,
    out: str,
    seed: int,
    n_lanes: int | None,
    frames: int | None,
    overrides: tuple[str, ...],
    images: bool,
    stereo: bool,
    video: bool,
    png: bool,
) -> None:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    With --images a rendered motorway: pictures, camera.yaml, the truth about every line.
    """
    import yaml

    from egolane_pgm.recordings.ground_truth import write_ground_truth
    from egolane_pgm.recordings.table import write_table
    from egolane_pgm.results import make_directory
    from egolane_pgm.simulation import simulate as make_drive
    from egolane_pgm.types import InputError

    values = _given(overrides, "change_s=5")
    for name, is_given in (("stereo", stereo), ("video", video), ("png", png)):
        if is_given and not images:
            raise InputError(f"--{name}: needs --images")
    if video and png:
        raise InputError("--video and --png: choose one")
    if images:
        from egolane_pgm.cli.render import write_images

        if n_lanes is not None:
            values["n_lanes"] = n_lanes
        write_images(preset, Path(out), seed, frames, values, stereo=stereo, video=video, png=png)
        return
    for name in ("preset", "seed", "frames", "n_lanes"):
        if name in values:
            raise InputError(f"--set {name}: is given by an argument or option of its own")
    drive = make_drive(preset, seed=seed, frames=frames, n_lanes=n_lanes, **values)
    folder = Path(out)
    make_directory(folder)
    write_table(folder / "lines.csv", drive.log)
    write_ground_truth(folder / "ground_truth.txt", drive.truth)
    experiment = {
        "name": f"simulated_{preset}_{seed}",
        "recording": {"path": "lines.csv"},
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": drive.n_lanes,
        "tuned_on": "not_tuned",
    }
    target = folder / "experiment.yaml"
    try:
        target.write_text(yaml.safe_dump(experiment, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}") from error
    click.echo(f"{len(drive)} frames; try: egolane run {target}")


@click.command()
@click.argument("experiment", type=click.Path(dir_okay=False))
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE")
def online(experiment: str, overrides: tuple[str, ...]) -> None:
    """Filter frame by frame: a JSON line in, the belief for it out at once.

    Reads `{"frame_id": 7, "lines": [{"offset_m": -1.8, "is_valid": true, "is_continuous": false,
    "lri": 10}]}` per line on standard input.
    """
    import json

    from egolane_pgm.experiment import load_experiment
    from egolane_pgm.online import filter_stream

    # Standard input as an iterator would be read ahead in blocks.
    sys.stdin.reconfigure(encoding="utf-8", errors="replace")  # type: ignore[union-attr]
    messages = iter(sys.stdin.readline, "")
    for belief in filter_stream(load_experiment(experiment, overrides), messages):
        click.echo(json.dumps(belief))
        sys.stdout.flush()
