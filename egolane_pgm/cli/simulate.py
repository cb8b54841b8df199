"""The command `egolane simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from tqdm import tqdm

from egolane_pgm.cli import options
from egolane_pgm.experiment import INTERCHANGE
from egolane_pgm.maps import lane_graph, load_map, road_table
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate as make_drive
from egolane_pgm.simulation.detector import DetectorModel
from egolane_pgm.simulation.interchange import (
    DETECTOR,
    Journey,
    made_up_map,
    mirrored,
    simulate_interchange,
)
from egolane_pgm.simulation.rendering.files import cost_estimate, free_places, write_drive
from egolane_pgm.simulation.rendering.render import check_settings, make_scene
from egolane_pgm.tools.files import as_csv, make_directory, write_text, write_yaml
from egolane_pgm.types import InputError, suggestion


@click.command()
@click.argument("preset", default="quickstart")
@click.option("--out", type=click.Path(file_okay=False), required=True, metavar="DIR")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--n-lanes", type=int)
@click.option("--frames", type=int, help="Length of the drive.")
@options.overrides(
    "Override a value of the preset's world or detector; with --images world or failures."
)
@click.option(
    "--map",
    "map_file",
    metavar="FILE",
    help="With interchange: the map that is driven over, .parquet or .osm.",
)
@click.option("--mirror", is_flag=True, help="With interchange: over the map's mirror image.")
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
    map_file: str | None,
    mirror: bool,
    images: bool,
    stereo: bool,
    video: bool,
    png: bool,
) -> None:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    The preset interchange drives over a map of lanes (--map, or one that is made up) and writes the
    map, the positions of a receiver and the road table too.

    With --images a rendered motorway: pictures, camera.yaml, the truth about every line.
    """
    values = options.given(overrides, "change_s=5")
    for name, is_given in (("stereo", stereo), ("video", video), ("png", png)):
        if is_given and not images:
            raise InputError(f"--{name}: needs --images")
    if video and png:
        raise InputError("--video and --png: choose one")
    folder = Path(out)
    if preset == INTERCHANGE:
        if images or n_lanes is not None:
            given = "--images" if images else "--n-lanes"
            raise InputError(f"{given}: does not go with {INTERCHANGE}")
        _write_interchange(folder, seed, frames, values, map_file, mirror=mirror)
        return
    if map_file is not None or mirror:
        raise InputError(f"{'--mirror' if mirror else '--map'}: goes with {INTERCHANGE} only")
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


def _write_interchange(
    folder: Path,
    seed: int,
    frames: int | None,
    overrides: Mapping[str, Any],
    map_file: str | None,
    *,
    mirror: bool,
) -> None:
    of_journey = {f.name for f in fields(Journey)} - {"n_frames"}
    known = of_journey | {f.name for f in fields(DetectorModel)}
    for key in overrides:
        if key not in known:
            raise InputError(f"simulation: unknown key '{key}'{suggestion(key, known)}")
    journey = Journey(**{k: v for k, v in overrides.items() if k in of_journey})
    if frames is not None:
        journey = replace(journey, n_frames=frames)
    of_detector = {k: v for k, v in overrides.items() if k not in of_journey}
    graph = made_up_map(seed) if map_file is None else load_map(map_file)
    if mirror:
        graph = mirrored(graph)
    drive = simulate_interchange(seed, graph, journey, replace(DETECTOR, **of_detector))
    make_directory(folder)
    write_table(folder / "lines.csv", drive.log)
    write_ground_truth(folder / "ground_truth.txt", drive.truth)
    lane_graph.save(graph, folder / "lanes.parquet")
    road_table.save(drive.road, folder / "road.parquet")
    rows = zip(drive.road.t_s.tolist(), *drive.position.T.tolist(), strict=True)
    write_text(folder / "positions.csv", as_csv(["t_s", "latitude", "longitude"], rows))
    counts = np.stack([drive.log.frame_id, drive.n_lanes, drive.on_map], axis=1).tolist()
    write_text(folder / "lanes_truth.csv", as_csv(["frame_id", "n_lanes", "on_map"], counts))
    experiment = {
        "name": f"simulated_interchange_{seed}",
        "recording": {"path": "lines.csv", "frame_rate": journey.frame_rate},
        "ground_truth": {"path": "ground_truth.txt"},
        "road": "road.parquet",
        "n_lanes": "map",
        "graph": "changing_lanes",
        "filter": "exact",
        "tuned_on": "not_tuned",
    }
    target = folder / "experiment.yaml"
    write_yaml(target, experiment)
    at = f"{folder / 'lanes.parquet'} {folder / 'positions.csv'} -o {folder / 'road.parquet'}"
    changes = int(np.count_nonzero(np.diff(drive.on_map)))
    click.echo(
        f"{len(drive)} frames, the number of lanes changes {changes} times; road.parquet is the"
        f" truth, `egolane locate {at}` finds it from the positions; try: egolane run {target}"
    )


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
    cost = cost_estimate(preset, seed, frames, overrides, stereo=stereo, video=video, png=png)
    if cost is not None:
        click.echo(cost, err=True)
    scene = make_scene(preset, seed, frames, stereo=stereo, **overrides)
    bar = partial(tqdm, unit="frame", disable=None)
    write_drive(scene, folder, preset, seed, places, png=png, progress=bar)
    click.echo(f"{len(scene)} frames in {folder}; see {folder / 'README.md'}")
