"""The verb `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import Road, SimulatedDrive, simulated_road
from egolane_pgm.simulation import simulate as make_drive
from egolane_pgm.tools.files import make_directory, write_yaml
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.options import Option, Progress, Seed, StrPath
from egolane_pgm.vision.simulated import write_drive

EXAMPLES = (
    "egolane simulate a4 --out drive --frames 600",
    "egolane simulate a4 --images --frames 100 --out pictures",
)


def simulate(
    preset: str = "quickstart",
    *,
    out: Annotated[StrPath | None, Option("DIR", required=True)] = None,
    seed: Seed = 0,
    n_lanes: int | None = None,
    frames: int | None = None,
    overrides: Annotated[
        Mapping[str, Any] | None, Option("KEY=VALUE", names=("--set",), example="change_s=5")
    ] = None,
    images: bool = False,
    progress: Progress = None,
) -> SimulatedDrive | Road:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    With images pictures of the drive instead of its lines: images/, camera.yaml, and an experiment
    to run on the lines that a detector finds in them.

    - out: their folder.
    - seed: of the drive.
    - n_lanes: number of lanes of the road.
    - frames: length of the drive.
    - overrides: override a value of the preset's world or detector; with images of the world.
    - images: draw pictures instead of lines.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns the drive, with images its road. Without `out` nothing is written.
    Raises InputError, one line, for whatever does not fit.

    >>> from egolane_pgm.verbs.simulate import simulate
    >>> drive = simulate("a4", frames=100)
    >>> len(drive.log), len(drive.truth)
    (100, 100)
    """
    values = dict(overrides or {})
    folder = None if out is None else Path(out)
    for key in ("preset", "seed", "frames", "n_lanes"):
        if key in values:
            raise InputError(f"overrides: {key} is a parameter beside it")
    name = f"simulated_{preset}_{seed}"
    if images:
        road = simulated_road(preset, seed, frames, n_lanes, **values)
        if folder is not None:
            shown = bar(range(len(road)), progress=progress, unit="frame")
            write_drive(road, folder, name, shown)
        return road
    drive = make_drive(preset, seed=seed, frames=frames, n_lanes=n_lanes, **values)
    if folder is not None:
        _write(folder, drive, name)
    return drive


def says(done: SimulatedDrive | Road, given: Mapping[str, Any]) -> str:
    """How long the drive is, and what to do with it."""
    folder = Path(given["out"])
    run = f"egolane run {folder / 'experiment.yaml'}"
    if isinstance(done, Road):
        seen = f"{folder / 'images'} --camera {folder / 'camera.yaml'}"
        detect = f"egolane detect {seen} --detector ml -o {folder / 'lines.parquet'}"
        return f"{len(done)} frames; try: {detect} && {run}"
    return f"{len(done)} frames; try: {run}"


def _write(folder: Path, drive: SimulatedDrive, name: str) -> None:
    """Write lines, truth, and an experiment."""
    make_directory(folder)
    write_table(folder / "lines.csv", drive.log)
    write_ground_truth(folder / "ground_truth.txt", drive.truth)
    experiment = {
        "name": name,
        "recording": {"path": "lines.csv"},
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": drive.n_lanes,
        "tuned_on": "not_tuned",
    }
    write_yaml(folder / "experiment.yaml", experiment)
