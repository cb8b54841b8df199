"""The verb `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from egolane_pgm.experiment import INTERCHANGE
from egolane_pgm.maps import lane_graph, load_map, road_table
from egolane_pgm.maps.interchange import (
    DETECTOR,
    InterchangeDrive,
    Journey,
    made_up_map,
    mirrored,
    simulate_interchange,
)
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import Road, SimulatedDrive, simulated_road
from egolane_pgm.simulation import simulate as make_drive
from egolane_pgm.simulation.detector import DetectorModel
from egolane_pgm.tools.files import as_csv, make_directory, write_text, write_yaml
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, suggestion
from egolane_pgm.verbs.given import Option, Progress, Seed, StrPath
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
    overrides: Annotated[Mapping[str, Any] | None, Option(example="change_s=5")] = None,
    map: Annotated[StrPath | None, Option("FILE")] = None,
    mirror: bool = False,
    images: bool = False,
    progress: Progress = None,
) -> SimulatedDrive | InterchangeDrive | Road:
    """Simulate a drive: lines.csv, ground_truth.txt and an experiment to run on them.

    The preset interchange drives over a map of lanes (one of yours, or one that is made up) and
    writes the map, the positions of a receiver and the road table too.

    With images pictures of the drive instead of its lines: images/, camera.yaml, and an experiment
    to run on the lines that a detector finds in them.

    - out: their folder.
    - seed: of the drive.
    - n_lanes: number of lanes of the road.
    - frames: length of the drive.
    - overrides: override a value of the preset's world or detector; with images of the world.
    - map: with interchange: the map that is driven over, .parquet or .osm.
    - mirror: with interchange: over the map's mirror image.
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
    if preset == INTERCHANGE:
        if images or n_lanes is not None:
            raise InputError(f"{'images' if images else 'n_lanes'}: goes without {INTERCHANGE}")
        return _interchange(folder, seed, frames, values, map, mirror)
    if map is not None or mirror:
        raise InputError(f"{'mirror' if mirror else 'map'}: goes with {INTERCHANGE} only")
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
        _write(folder, drive, name, {"n_lanes": drive.n_lanes})
    return drive


def says(done: SimulatedDrive | InterchangeDrive | Road, given: Mapping[str, Any]) -> str:
    """How long the drive is, and what to do with it."""
    folder = Path(given["out"])
    run = f"egolane run {folder / 'experiment.yaml'}"
    if isinstance(done, Road):
        seen = f"{folder / 'images'} --camera {folder / 'camera.yaml'}"
        detect = f"egolane detect {seen} --detector ml -o {folder / 'lines.parquet'}"
        return f"{len(done)} frames; try: {detect} && {run}"
    if isinstance(done, SimulatedDrive):
        return f"{len(done)} frames; try: {run}"
    at = f"{folder / 'lanes.parquet'} {folder / 'positions.csv'} -o {folder / 'road.parquet'}"
    return (
        f"{len(done)} frames, the number of lanes changes"
        f" {np.count_nonzero(np.diff(done.on_map))} times; road.parquet is the truth,"
        f" `egolane locate {at}` finds it from the positions; try: {run}"
    )


def _write(
    folder: Path,
    drive: SimulatedDrive | InterchangeDrive,
    name: str,
    keys: Mapping[str, Any],
    **recording: Any,
) -> None:
    """Write lines, truth, and an experiment with some keys."""
    make_directory(folder)
    write_table(folder / "lines.csv", drive.log)
    write_ground_truth(folder / "ground_truth.txt", drive.truth)
    experiment = {
        "name": name,
        "recording": {"path": "lines.csv", **recording},
        "ground_truth": {"path": "ground_truth.txt"},
        **keys,
        "tuned_on": "not_tuned",
    }
    write_yaml(folder / "experiment.yaml", experiment)


def _interchange(
    folder: Path | None,
    seed: int,
    frames: int | None,
    values: Mapping[str, Any],
    map: StrPath | None,
    mirror: bool,
) -> InterchangeDrive:
    of_journey = {f.name for f in fields(Journey)} - {"n_frames"}
    known = of_journey | {f.name for f in fields(DetectorModel)}
    for key in values:
        if key not in known:
            raise InputError(f"simulation: unknown key '{key}'{suggestion(key, known)}")
    journey = Journey(**{k: v for k, v in values.items() if k in of_journey})
    if frames is not None:
        journey = replace(journey, n_frames=frames)
    of_detector = {k: v for k, v in values.items() if k not in of_journey}
    graph = made_up_map(seed) if map is None else load_map(Path(map))
    if mirror:
        graph = mirrored(graph)
    drive = simulate_interchange(seed, graph, journey, replace(DETECTOR, **of_detector))
    if folder is None:
        return drive
    keys = {"road": "road.parquet", "n_lanes": "map", "graph": "changing_lanes", "filter": "exact"}
    name = f"simulated_interchange_{seed}"
    _write(folder, drive, name, keys, frame_rate=journey.frame_rate)
    lane_graph.save(graph, folder / "lanes.parquet")
    road_table.save(drive.road, folder / "road.parquet")
    rows = zip(drive.road.t_s.tolist(), *drive.position.T.tolist(), strict=True)
    write_text(folder / "positions.csv", as_csv(["t_s", "latitude", "longitude"], rows))
    counts = np.stack([drive.log.frame_id, drive.n_lanes, drive.on_map], axis=1).tolist()
    write_text(folder / "lanes_truth.csv", as_csv(["frame_id", "n_lanes", "on_map"], counts))
    return drive
