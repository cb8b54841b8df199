"""The command `egolane simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from egolane_pgm.cli import options
from egolane_pgm.files import make_directory, write_yaml
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate as make_drive
from egolane_pgm.simulation.rendering.files import cost_estimate, free_places, write_drive
from egolane_pgm.simulation.rendering.render import check_settings, make_scene
from egolane_pgm.types import InputError


@click.command()
@click.argument("preset", default="quickstart")
@click.option("--out", type=click.Path(file_okay=False), required=True, metavar="DIR")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--n-lanes", type=int)
@click.option("--frames", type=int, help="Length of the drive.")
@options.overrides(
    "Override a value of the preset's world or detector; with --images world or failures."
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
    values = options.given(overrides, "change_s=5")
    for name, is_given in (("stereo", stereo), ("video", video), ("png", png)):
        if is_given and not images:
            raise InputError(f"--{name}: needs --images")
    if video and png:
        raise InputError("--video and --png: choose one")
    folder = Path(out)
    if images:
        if n_lanes is not None:
            values["n_lanes"] = n_lanes
        _write_images(preset, folder, seed, frames, values, stereo=stereo, video=video, png=png)
        return
    for name in ("preset", "seed", "frames", "n_lanes"):
        if name in values:
            raise InputError(f"--set {name}: is given by an argument or option of its own")
    drive = make_drive(preset, seed=seed, frames=frames, n_lanes=n_lanes, **values)
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
    write_yaml(target, experiment)
    click.echo(f"{len(drive)} frames; try: egolane run {target}")


def _write_images(
    preset: str,
    folder: Path,
    seed: int,
    frames: int | None,
    overrides: Mapping[str, Any],
    *,
    stereo: bool,
    video: bool,
    png: bool,
) -> None:
    check_settings(overrides)
    places = free_places(folder, stereo=stereo, video=video)
    cost = cost_estimate(
        preset, seed, frames, overrides, folder, stereo=stereo, video=video, png=png
    )
    if cost is not None:
        click.echo(cost, err=True)
    scene = make_scene(preset, seed, frames, stereo=stereo, **overrides)
    bar = partial(tqdm, unit="frame", disable=None)
    write_drive(scene, folder, preset, seed, places, png=png, progress=bar)
    click.echo(f"{len(scene)} frames in {folder}; see {folder / 'README.md'}")
