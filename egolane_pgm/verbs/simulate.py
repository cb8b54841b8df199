"""The verb `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import Road, SimulatedDrive, simulated_road
from egolane_pgm.simulation import simulate as make_drive
from egolane_pgm.tools.files import make_directory, write_yaml
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.options import Hidden, Option, Progress, StrPath
from egolane_pgm.vision.simulated import write_drive

EXAMPLES = (
    "egolane simulate a4 --out drive --frames 600 --set seed=1",
    "egolane simulate a4 --images --frames 100 --out pictures",
)


def simulate(
    preset: str = "quickstart",
    *,
    out: Annotated[StrPath | None, Option("DIR", required=True)] = None,
    seed: Annotated[int, Ge(0), Hidden] = 0,
    n_lanes: Annotated[int | None, Hidden] = None,
    frames: int | None = None,
    overrides: Annotated[
        Mapping[str, Any] | None, Option("KEY=VALUE", names=("--set",), example="change_s=5")
    ] = None,
    images: bool = False,
    progress: Progress = None,
) -> SimulatedDrive | Road:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    With images draw pictures of the drive instead of lines: images/, camera.yaml, and an experiment
    for the lines that a detector finds in them.

    - out: their folder.
    - seed, n_lanes: random seed; number of lanes of the road.
    - frames: length of the drive.
    - overrides: seed, n_lanes, or a value of the preset's world or detector, e.g. change_s=5.
    - images: draw pictures instead of lines.
    - progress: whether to show a bar; by default in a terminal.

    Returns the drive, with images its road. Without `out` no file is written.
    Raises InputError, one line, for arguments that do not fit.

    >>> from egolane_pgm.verbs.simulate import simulate
    >>> drive = simulate("a4", frames=100)
    >>> len(drive.log), len(drive.truth)
    (100, 100)
    """
    values: dict[str, Any] = {"preset": preset, "seed": seed, "n_lanes": n_lanes, "frames": frames}
    values |= overrides or {}
    if not isinstance(values["seed"], int):
        raise InputError(f"seed: {values['seed']!r} is not a whole number")
    folder = None if out is None else Path(out)
    name = f"simulated_{values['preset']}_{values['seed']}"
    if images:
        road = simulated_road(**values)
        if folder is not None:
            shown = bar(range(len(road)), progress=progress, unit="frame")
            write_drive(road, folder, name, shown)
        return road
    drive = make_drive(**values)
    if folder is not None:
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
    return drive


def summary(done: SimulatedDrive | Road, given: Mapping[str, Any]) -> str:
    """The length of the drive, and the commands that use it."""
    folder = Path(given["out"])
    run = f"egolane run {folder / 'experiment.yaml'}"
    if isinstance(done, Road):
        pictures = f"{folder / 'images'} --camera {folder / 'camera.yaml'}"
        detect = f"egolane detect {pictures} --detector ml -o {folder / 'lines.parquet'}"
        return f"{len(done)} frames; try: {detect} && {run}"
    return f"{len(done)} frames; try: {run}"
