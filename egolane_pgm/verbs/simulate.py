"""The verb `simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.loading import parse_overrides
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate as simulate_drive
from egolane_pgm.simulation import simulated_road
from egolane_pgm.tools.files import make_directory, write_yaml
from egolane_pgm.tools.options import Option, Overrides, StrPath
from egolane_pgm.types import InputError
from egolane_pgm.vision.simulated import write_pictures

EXAMPLES = (
    "egolane simulate a4 --out drive --frames 600 --set seed=1",
    "egolane simulate a4 --images --frames 100 --out pictures",
)


def simulate(
    preset: str = "quickstart",
    *,
    out: Annotated[StrPath, Option("DIR")],
    frames: int | None = None,
    overrides: Overrides = (),
    images: bool = False,
) -> str:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    With images draw pictures of the drive instead of lines: images/, camera.yaml, and an experiment
    for the lines that a detector finds in them.

    - out: their folder.
    - frames: length of the drive.
    - overrides: seed, n_lanes, or a value of the preset's world or detector, e.g. change_s=5.
    - images: draw pictures instead of lines.

    Returns the length of the drive and the commands that use it. Raises InputError for arguments
    that do not fit.
    """
    values: dict[str, Any] = {"seed": 0, **parse_overrides(overrides)}
    if not isinstance(values["seed"], int):
        raise InputError(f"seed: {values['seed']!r} is not a whole number")
    folder = Path(out)
    run = f"egolane run {folder / 'experiment.yaml'}"
    if images:
        road = simulated_road(preset, frames=frames, **values)
        write_pictures(road, folder)
        recording = {"path": "lines.parquet", "frame_rate": road.frame_rate}
        pictures = f"{folder / 'images'} --camera {folder / 'camera.yaml'}"
        run = f"egolane detect {pictures} --detector ml -o {folder / 'lines.parquet'} && {run}"
        truth = road.truth
        n_lanes = road.n_lanes
    else:
        drive = simulate_drive(preset, frames=frames, **values)
        make_directory(folder)
        write_table(folder / "lines.csv", drive.log)
        recording = {"path": "lines.csv"}
        truth = drive.truth
        n_lanes = drive.n_lanes
    write_ground_truth(folder / "ground_truth.txt", truth)
    experiment = {
        "name": f"simulated_{preset}_{values['seed']}",
        "recording": recording,
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": n_lanes,
        "tuned_on": "not_tuned",
    }
    write_yaml(folder / "experiment.yaml", experiment)
    return f"{len(truth)} frames; try: {run}"
