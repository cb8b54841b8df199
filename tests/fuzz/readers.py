"""The readers that are tried, each with whole files to damage."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import optuna
import yaml

import egolane_pgm as ego
from egolane_pgm.camera.model import read_camera, write_camera
from egolane_pgm.camera.pictures import images_of, open_source
from egolane_pgm.cli.show import compile_defaults
from egolane_pgm.drive import check_sources
from egolane_pgm.experiment import load_experiment
from egolane_pgm.fleet import drive_experiment, read_fleet
from egolane_pgm.maps import load_map
from egolane_pgm.maps.lane_graph import save as save_graph
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.model import prepare_model
from egolane_pgm.online import filter_stream
from egolane_pgm.plugins import load_plugin
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.recordings.rosbag_writer import write_rosbag
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tuning.plan import PicturePlan, check_plan, read_plan
from egolane_pgm.tuning.search import Settings
from egolane_pgm.tuning.storage import (
    JOURNAL_NAME,
    check_study,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.types import InputError
from tests.kits.bags import line_bag, write_bag2, write_fixes2
from tests.kits.drives import short_drive, write_drive
from tests.kits.image_line_files import CAMERA, culane, entry, openlane, saved_camera, tusimple
from tests.kits.osm_files import write_osm
from tests.kits.streams import messages
from tests.kits.synthetic_road import images, write_pictures, write_video

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True)
class Reader:
    """A reader, and whole files that it takes.

    - make: writes files into a folder, and returns what is read of them: files and folders.
    - read: reads one of these.
    """

    name: str
    make: Callable[[Path], list[Path]]
    read: Callable[[Path], object]


#: The frames that recordings have here.
_LOG = short_drive(40).log


# --- recordings ----------------------------------------------------------------------------------


def _bags(folder: Path) -> list[Path]:
    write_rosbag(folder / "a.bag", _LOG)
    write_rosbag(folder / "a.mcap", _LOG)
    return [
        folder / "a.bag",
        line_bag(folder / "plain.bag", [1, 2, 3]),
        folder / "a.mcap",
        write_bag2(folder / "sqlite", _LOG),
        write_bag2(folder / "mcap", _LOG, storage="MCAP"),
    ]


def _tables(folder: Path) -> list[Path]:
    names = ["a.csv", "a.parquet", "wide.csv", "wide.parquet"]
    for name in names[:2]:
        write_table(folder / name, _LOG)
    import pandas as pd

    wide = {"frame_id": _LOG.frame_id}
    for k in range(min(_LOG.offset_m.shape[1], 3)):
        wide |= {f"offset_{k + 1}": _LOG.offset_m[:, k], f"lri_{k + 1}": _LOG.lri[:, k]}
    pd.DataFrame(wide).to_csv(folder / names[2], index=False)
    pd.DataFrame(wide).to_parquet(folder / names[3])
    return [folder / name for name in names]


def _truth(folder: Path) -> list[Path]:
    write_drive(folder, 40)
    return [folder / "ground_truth.txt"]


def _tusimple(folder: Path) -> list[Path]:
    rows = [entry(k, run_time=20) for k in range(1, 8)]
    tusimple(folder / "a.json", rows)
    tusimple(folder / "b.jsonl", [{**row, "classes": [1, 2, 4]} for row in rows])
    return [folder / "a.json", folder / "b.jsonl"]


def _openlane(folder: Path) -> list[Path]:
    metres = {
        "file_path": "validation/segment-3/150767.jpg",
        "extrinsic": np.eye(4).tolist(),
        "intrinsic": [[2000, 0, 960], [0, 2000, 640], [0, 0, 1]],
        "lane_lines": [
            {"category": 2, "visibility": [1, 1, 1, 0], "xyz": [[5, 9, 20, 30], [1.5] * 4, [0] * 4]}
        ],
    }
    (folder / "metres").mkdir()
    (folder / "metres" / "1507670000000000.json").write_text(json.dumps(metres))
    return [openlane(folder / "pixels", [1507670000000000, 1507670000100000]), folder / "metres"]


def _seen(path: Path) -> None:
    read_lines(path, format="culane" if path.name == "culane" else "openlane", camera=CAMERA)


# --- YAML ----------------------------------------------------------------------------------------

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
        "choice": {"grid": {"jump": [0.001, 0.01]}},
    },
    "hard": {
        "recording": {"simulate": "quickstart", "frames": [0, 30]},
        "graph": "autoregressive",
        "filter": "smoothed",
        "decode": "viterbi",
        "fit": "learn",
        "learning": {"iterations": 3, "strength": 10.0, "tables": ["Lane"]},
    },
}


def _experiments(folder: Path) -> list[Path]:
    write_drive(folder, 30)
    found = [folder / "experiment.yaml"]
    for name, content in _EXPERIMENTS.items():
        file = folder / f"{name}.yaml"
        file.write_text(yaml.safe_dump({"name": name, "n_lanes": 4, **content}, sort_keys=False))
        found.append(file)
    including = folder / "including.yaml"
    including.write_text("include: plain.yaml\nname: more\nfilter: exact\n")
    return [*found, including]


def _checked(path: Path) -> None:
    experiment = load_experiment(path)
    prepare_model(experiment)
    check_sources(experiment)


def _cameras(folder: Path) -> list[Path]:
    saved_camera(folder)
    write_camera(
        folder / "pair.yaml", replace(CAMERA, baseline_m=0.4, ignore=((0, 600, 200, 720),))
    )
    return [folder / "cam.yaml", folder / "pair.yaml"]


def _plans(folder: Path) -> list[Path]:
    _experiments(folder)
    one = {
        "name": "several",
        "experiments": ["plain.yaml"],
        "tuning": {
            "objective": ["accuracy", "log_loss"],
            "sampler": "nsga2",
            "trials": 10,
            "parameters": {"sigma1": [0.1, 1], "p2": 0.9, "bonus_value": [0, 9]},
        },
    }
    (folder / "tune.yaml").write_text(yaml.safe_dump(one))
    return [folder / "tune.yaml", folder / "plain.yaml"]


def _planned(path: Path) -> None:
    plan = read_plan(path)
    if not isinstance(plan, PicturePlan):
        check_plan(plan)


_GRAPHS = """\
nodes: {Lane: n_lanes, SensorState: [OK, BAD], DetectorOutput: n_lanes, How: 3}
hidden: [Lane, SensorState, How]
observed: [DetectorOutput]
unused: [WeightOfReliability]
edges:
  within: [Lane -> DetectorOutput, SensorState -> DetectorOutput, SensorState -> How]
  across: [Lane -> Lane, SensorState -> SensorState]
parameters:
  sigma1: {kind: sigma, default: 0.4, bounds: [0, 3], doc: how far}
  p1: {kind: probability, default: 0.9}
  wide: {kind: positive, default: 0.5, per_lane: true}
  how: {kind: choice, default: density, choices: [density, integral]}
tables:
  Lane: {first: uniform, next: {normal: {around: Lane before, sigma: sigma1, how: how}}}
  SensorState:
    first: {rows: {values: [p1, rest]}}
    next: {binary: {of: SensorState before, ok: p1, bad: 0.8}}
  How: {rows: {of: SensorState, values: [[0.2, 0.3, 0.5], [0.1, 1 - p1, rest]]}}
  DetectorOutput:
    stack:
      over: SensorState
      OK: {stack: {over: Lane, else: {rows: {values: [0.25, 0.25, 0.25, rest]}}}}
      BAD: {normal: {around: Lane, sigma: 0.5, widths: 1.0}}
"""


def _graphs(folder: Path) -> list[Path]:
    made = folder / "own.yaml"
    made.write_text(_GRAPHS)
    shown = folder / "shown.yaml"
    shown.write_text((EXAMPLES / "sensor_failure.yaml").read_text())
    return [made, shown]


def _compiled(path: Path) -> None:
    module = load_plugin("graphs", path.name, path.parent, str(path))
    compile_defaults(str(path), module, 4)


# --- fleets, results, studies --------------------------------------------------------------------


def _fleets(folder: Path) -> list[Path]:
    import pandas as pd

    write_drive(folder, 30)
    drives = [
        {"recording": "lines.csv", "n_lanes": 3, "tag.road": "A4", "parameters.sigma1": 0.3},
        {
            "recording": "lines.csv",
            "n_lanes": 4,
            "tag.road": "A2",
            "name": "b",
            "ground_truth": "none",
        },
    ]
    table = pd.DataFrame(drives)
    table.to_csv(folder / "fleet.csv", index=False)
    table.to_parquet(folder / "fleet.parquet")
    (folder / "fleet.yaml").write_text(yaml.safe_dump({"drives": drives}))
    return [folder / f"fleet.{kind}" for kind in ("csv", "parquet", "yaml")]


def _driven(path: Path) -> None:
    base = load_experiment(path.parent / "experiment.yaml")
    for drive in read_fleet(path):
        drive_experiment(base, drive)


def _results(folder: Path) -> list[Path]:
    write_drive(folder, 40)
    ego.run(folder / "experiment.yaml").save(folder / "result", figures=False)
    return [folder / "result"]


def _shown(path: Path) -> None:
    """What a report reads of it."""
    run = ego.load_result(path)
    run.to_pandas()
    assert len(run.events) >= 0


def _searched(folder: Path) -> list[Path]:
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


def _drawn(path: Path) -> None:
    ego.load_result(path).trials()


_IDENTITY = {"space": {"searched": {"x": [0.0, 1.0]}}, "seed": 0}


def _storages(folder: Path) -> list[Path]:
    (folder / "journal").mkdir()
    (folder / "base").mkdir()
    for url, place in ((None, folder / "journal"), (f"sqlite:///{folder}/base/study.db", folder)):
        study = open_study(open_storage(url, place), "drive", Settings(), _IDENTITY)
        for k in range(4):
            trial = study.ask({"x": optuna.distributions.FloatDistribution(0, 1)})
            study.tell(trial, k / 4)
    return [folder / "journal", folder / "base"]


def _opened(path: Path) -> None:
    is_journal = (path / JOURNAL_NAME).exists()
    url = None if is_journal else f"sqlite:///{path}/study.db"
    try:
        with storage_errors(url):
            storage = open_storage(url, path)
            check_study(storage, "drive", _IDENTITY)
            study = open_study(storage, "drive", Settings(), _IDENTITY)
            study.get_trials(deepcopy=False)
    except InputError as error:
        # What is in a storage goes by the name of the study.
        raise InputError(*(f"{path}: {line}" for line in error.lines)) from error


# --- pictures ------------------------------------------------------------------------------------


def _pictures(folder: Path) -> list[Path]:
    small = [cv2.resize(image, (96, 54)) for image in images(1)]
    kinds = ("png", "jpg", "tiff", "bmp", "webp", "ppm")
    for kind in kinds:
        write_pictures(folder, small, f"{{:d}}.{kind}")
    return [folder / f"0.{kind}" for kind in kinds]


def _videos(folder: Path) -> list[Path]:
    small = [cv2.resize(image, (96, 64)) for image in images(12)]
    return [
        write_video(folder / "a.avi", small),
        write_video(folder / "a.mp4", small, four="mp4v"),
        write_video(folder / "a.mkv", small, four="MJPG"),
    ]


def _looked_at(path: Path) -> None:
    for _ in itertools.islice(images_of(open_source(path), None), 60):
        pass


# --- positions and maps --------------------------------------------------------------------------


def _positions(folder: Path) -> list[Path]:
    import pandas as pd

    rows = [(1.6e9 + k, 50 + 1e-4 * k, 11 + 1e-4 * k) for k in range(12)]
    table = pd.DataFrame(rows, columns=["t_s", "latitude", "longitude"])
    table.to_csv(folder / "a.csv", index=False)
    table.to_parquet(folder / "a.parquet")
    table.assign(t_s=pd.to_datetime(table.t_s, unit="s").astype(str)).to_csv(
        folder / "dates.csv", index=False
    )
    points = "".join(
        f'<trkpt lat="{n:.5f}" lon="{e:.5f}"><time>2020-01-01T00:00:{k:02d}Z</time></trkpt>'
        for k, (_, n, e) in enumerate(rows)
    )
    (folder / "a.gpx").write_text(
        '<?xml version="1.0"?><gpx version="1.1" creator="x"'
        f' xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'
    )
    (folder / "a.nmea").write_text(
        "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\n"
        "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n"
    )
    names = ("a.csv", "a.parquet", "dates.csv", "a.gpx", "a.nmea")
    return [*(folder / name for name in names), write_fixes2(folder / "fixes", rows)]


def _maps(folder: Path) -> list[Path]:
    tags = {
        "highway": "motorway",
        "lanes": 3,
        "oneway": "yes",
        "turn:lanes": "||right",
        "ref": "A 4",
    }
    places = {k: (500.0 * k, 3.0 * k) for k in range(1, 7)}
    ways = [(7, [1, 2, 3], tags), (8, [3, 4, 5, 6], {**tags, "lanes": 2, "turn:lanes": "|"})]
    write_osm(folder / "a.osm", places, ways)
    save_graph(load_map(folder / "a.osm"), folder / "a.parquet")
    return [folder / "a.osm", folder / "a.parquet"]


def _roads(folder: Path) -> list[Path]:
    from egolane_pgm.maps.road_table import COLUMNS, RoadTable, save

    n = 8
    kinds: dict[str, Any] = {"segment": 0, "n_lanes": 3, "next_n_lanes": 0, "next_side": 0}
    kinds |= {"next_join": "", "next_optional": ""}
    columns = {name: np.full(n, kinds.get(name, 1.0)) for name in COLUMNS}
    columns["t_s"] = np.arange(n) / 10
    save(RoadTable(**columns), folder / "road.parquet")
    return [folder / "road.parquet"]


# --- frames that come one by one -----------------------------------------------------------------


def _streams(folder: Path) -> list[Path]:
    lines = list(itertools.islice(messages(_LOG), 12))
    (folder / "stream.jsonl").write_text("\n".join(lines) + "\n")
    return [folder / "stream.jsonl"]


def _filtered(path: Path) -> None:
    experiment = load_experiment(EXPERIMENTS / "quickstart.yaml")
    # As the command reads standard input.
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        for _ in filter_stream(experiment, lines):
            pass
    except InputError as error:
        raise InputError(*(f"{path}: {line}" for line in error.args)) from error


def _run(path: Path) -> None:
    """An experiment from end to end."""
    ego.run(path)


READERS = (
    Reader("bags", _bags, read_lines),
    Reader("tables", _tables, read_lines),
    Reader("ground truth", _truth, read_ground_truth),
    Reader("TuSimple", _tusimple, lambda path: read_lines(path, camera=CAMERA)),
    Reader("CULane", lambda folder: [culane(folder / "culane", range(8))], _seen),
    Reader("OpenLane", _openlane, _seen),
    Reader("frames one by one", _streams, _filtered),
    Reader("experiments", _experiments, _checked),
    Reader("runs of experiments", _experiments, _run),
    Reader("tuning files", _plans, _planned),
    Reader("graphs in YAML", _graphs, _compiled),
    Reader("cameras", _cameras, read_camera),
    Reader("fleets", _fleets, _driven),
    Reader("results", _results, _shown),
    Reader("studies", _searched, _drawn),
    Reader("study storages", _storages, _opened),
    Reader("pictures", _pictures, _looked_at),
    Reader("videos", _videos, _looked_at),
    Reader("positions", _positions, read_positions),
    Reader("maps", _maps, load_map),
    Reader("road tables", _roads, load_road),
)
