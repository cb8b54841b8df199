"""The readers that are tried, each with whole files to damage."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import pandas as pd
import yaml

import egolane_pgm as ego
from egolane_pgm.drive import check_sources
from egolane_pgm.experiment import load_experiment
from egolane_pgm.fleet import drive_experiment, read_fleet
from egolane_pgm.maps import load_map
from egolane_pgm.maps.lane_graph import save as save_graph
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.model import prepare_model
from egolane_pgm.plugins import load_plugin
from egolane_pgm.recordings import read_lines, write_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.verbs.show import compile_defaults
from egolane_pgm.vision.camera.model import read_camera, write_camera
from egolane_pgm.vision.camera.pictures import images_of, open_source
from tests.kits.bags import write_bag2
from tests.kits.drives import short_drive, write_drive
from tests.kits.image_line_files import CAMERA, culane, entry, openlane, saved_camera, tusimple
from tests.kits.osm_files import write_osm
from tests.kits.synthetic_road import images, write_pictures, write_video

EXAMPLES = Path(__file__).parents[2] / "examples"
EXPERIMENTS = Path(__file__).parents[2] / "experiments"


@dataclass(frozen=True)
class Reader:
    """A reader, and whole files that it takes.

    - make: writes files into a folder, and returns what is read of them: files and folders.
    - read: reads one of these.
    """

    make: Callable[[Path], list[Path]]
    read: Callable[[Path], object]


#: The frames that recordings have here.
_LOG = short_drive(40).log


def _bags(folder: Path) -> list[Path]:
    for name in ("a.bag", "a.mcap"):
        write_lines(folder / name, _LOG)
    return [folder / "a.bag", folder / "a.mcap", write_bag2(folder / "sqlite", _LOG)]


def _tables(folder: Path) -> list[Path]:
    for name in ("a.csv", "a.parquet"):
        write_lines(folder / name, _LOG)
    wide = {"frame_id": _LOG.frame_id}
    for k in range(2):
        wide |= {f"offset_{k + 1}": _LOG.offset_m[:, k], f"lri_{k + 1}": _LOG.lri[:, k]}
    pd.DataFrame(wide).to_csv(folder / "wide.csv", index=False)
    return [folder / name for name in ("a.csv", "a.parquet", "wide.csv")]


def _truth(folder: Path) -> list[Path]:
    write_drive(folder, 40)
    return [folder / "ground_truth.txt"]


def _labels(folder: Path) -> list[Path]:
    tusimple(folder / "a.json", [entry(k, run_time=20) for k in range(1, 8)])
    lines = openlane(folder / "openlane", [1507670000000000, 1507670000100000])
    return [folder / "a.json", culane(folder / "culane", range(8)), lines]


def _labelled(path: Path) -> None:
    known = path.name if path.name in ("culane", "openlane") else None
    read_lines(path, format=known, camera=CAMERA)


_EXPERIMENTS: dict[str, dict[str, Any]] = {
    "plain": {
        "recording": {"path": "lines.csv", "frame_rate": 10, "columns": {"offset_m": "offset_m"}},
        "ground_truth": {"path": "ground_truth.txt", "extra_rows": [[10000, 1, 0]]},
        "parameters": {"sigma1": 0.3, "p1": 0.9, "bonus_value": 4},
        "tuning": {"trials": 5, "parameters": {"p1": [0.5, 1]}, "never_fit": [[0, 10]]},
    },
    "place": {
        "recording": {"simulate": "quickstart", "frames": [0, 30], "seed": 1},
        "evidence": "line_geometry",
        "graph": "position_in_lane",
        "filter": "fixed_lag",
        "lag": 5,
        "parameters": {"cells": 4, "motion_bins": 9, "fallback_width_m": 3.5},
        "learning": {"iterations": 3, "strength": 10.0},
    },
}


def _experiments(folder: Path) -> list[Path]:
    write_drive(folder, 30)
    for name, content in _EXPERIMENTS.items():
        content = {"name": name, "n_lanes": 4, **content}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    (folder / "including.yaml").write_text("include: plain.yaml\nname: more\nfilter: exact\n")
    return [folder / f"{name}.yaml" for name in ("plain", "place", "including")]


def _checked(path: Path) -> None:
    experiment = load_experiment(path)
    prepare_model(experiment)
    check_sources(experiment)


def _graphs(folder: Path) -> list[Path]:
    made = folder / "own.yaml"
    made.write_text((EXAMPLES / "sensor_failure.yaml").read_text())
    return [made]


def _compiled(path: Path) -> None:
    module = load_plugin("graphs", path.name, path.parent, str(path))
    compile_defaults(str(path), module, 4)


def _cameras(folder: Path) -> list[Path]:
    saved_camera(folder)
    pair = replace(CAMERA, baseline_m=0.4, ignore=((0, 600, 200, 720),))
    write_camera(folder / "pair.yaml", pair)
    return [folder / "cam.yaml", folder / "pair.yaml"]


def _fleets(folder: Path) -> list[Path]:
    write_drive(folder, 30)
    drives = [
        {"recording": "lines.csv", "n_lanes": n, "name": f"drive{n}", "tag.road": "A4"}
        for n in (3, 4)
    ]
    pd.DataFrame(drives).to_csv(folder / "fleet.csv", index=False)
    (folder / "fleet.yaml").write_text(yaml.safe_dump({"drives": drives}))
    return [folder / "fleet.csv", folder / "fleet.yaml"]


def _driven(path: Path) -> None:
    base = load_experiment(path.parent / "experiment.yaml")
    for drive in read_fleet(path):
        drive_experiment(base, drive)


def _results(folder: Path) -> list[Path]:
    write_drive(folder, 40)
    ego.run(folder / "experiment.yaml").save(folder / "result", figures=False)
    return [folder / "result"]


def _studies(folder: Path) -> list[Path]:
    tuned = ego.tune(
        EXPERIMENTS / "quickstart.yaml",
        trials=3,
        in_sample_only=True,
        parameter={"sigma1": [0.2, 0.5], "bonus_value": [0, 3]},
        overrides={"recording.frames": [0, 60]},
        progress=False,
    )
    tuned.save(folder / "study", figures=False)
    return [folder / "study"]


def _pictures(folder: Path) -> list[Path]:
    small = [cv2.resize(image, (96, 64)) for image in images(12)]
    for kind in ("png", "jpg", "bmp"):
        write_pictures(folder, small[:1], f"{{:d}}.{kind}")
    write_video(folder / "a.avi", small)
    write_video(folder / "a.mp4", small, four="mp4v")
    return [folder / name for name in ("0.png", "0.jpg", "0.bmp", "a.avi", "a.mp4")]


def _looked_at(path: Path) -> None:
    for _ in itertools.islice(images_of(open_source(path), None), 60):
        pass


def _positions(folder: Path) -> list[Path]:
    rows = [(1.6e9 + k, 50 + 1e-4 * k, 11 + 1e-4 * k) for k in range(12)]
    table = pd.DataFrame(rows, columns=["t_s", "latitude", "longitude"])
    table.to_csv(folder / "a.csv", index=False)
    table.to_parquet(folder / "a.parquet")
    points = "".join(
        f'<trkpt lat="{n:.5f}" lon="{e:.5f}"><time>2020-01-01T00:00:{k:02d}Z</time></trkpt>'
        for k, (_, n, e) in enumerate(rows)
    )
    (folder / "a.gpx").write_text(
        '<?xml version="1.0"?><gpx version="1.1" creator="x"'
        f' xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'
    )
    return [folder / name for name in ("a.csv", "a.parquet", "a.gpx")]


def _maps(folder: Path) -> list[Path]:
    tags = {"highway": "motorway", "lanes": 3, "oneway": "yes", "turn:lanes": "||right"}
    places = {k: (500.0 * k, 3.0 * k) for k in range(1, 7)}
    ways = [(7, [1, 2, 3], tags), (8, [3, 4, 5, 6], {**tags, "lanes": 2, "turn:lanes": "|"})]
    write_osm(folder / "a.osm", places, ways)
    save_graph(load_map(folder / "a.osm"), folder / "a.parquet")
    return [folder / "a.osm", folder / "a.parquet"]


READERS = {
    "bags": Reader(_bags, read_lines),
    "tables": Reader(_tables, read_lines),
    "ground truth": Reader(_truth, read_ground_truth),
    "labels": Reader(_labels, _labelled),
    "experiments": Reader(_experiments, _checked),
    "runs of experiments": Reader(_experiments, ego.run),
    "graphs in YAML": Reader(_graphs, _compiled),
    "cameras": Reader(_cameras, read_camera),
    "fleets": Reader(_fleets, _driven),
    "results": Reader(_results, lambda path: ego.load_result(path).to_pandas()),
    "studies": Reader(_studies, lambda path: ego.load_result(path).trials()),
    "pictures": Reader(_pictures, _looked_at),
    "positions": Reader(_positions, read_positions),
    "maps": Reader(_maps, load_map),
}
