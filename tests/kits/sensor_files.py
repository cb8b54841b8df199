"""Small files of each kind of recording that cars make, with the same lines: 100 frames, ten a
second, of a car in the middle one of three lanes, which swings by 30 cm."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

N_FRAMES = 100
START_NS = 1_700_000_000_000_000_000

#: The definitions of message types that ROS itself does not have.
TYPES = {
    "mobileye_560_660_msgs/msg/LkaLane": "std_msgs/Header header\nuint8 lane_type\nuint8 quality\n"
    "uint8 model_degree\nfloat64 position_parameter_c0\nfloat64 curvature_parameter_c2\n",
    "derived_object_msgs/msg/Lane": "uint8 quality\nuint8 marker_kind\nfloat64 marker_offset\n",
    "derived_object_msgs/msg/LaneModels": "std_msgs/Header header\n"
    "derived_object_msgs/Lane left_lane\nderived_object_msgs/Lane right_lane\n"
    "derived_object_msgs/Lane[] additional_lanes\n",
}


def offsets_m(frame: int) -> list[float]:
    """The lines of a frame from left to right, metres, negative to the left."""
    return [round(y + 0.3 * float(np.sin(frame / 8)), 3) for y in (-5.25, -1.75, 1.75, 5.25)]


def _rows(path: Path, heading: Sequence[str], rows: Iterator[Sequence[Any]], **style: Any) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, **style)
        writer.writerow(heading)
        writer.writerows(rows)


def _per_line(form: Any) -> Iterator[Sequence[Any]]:
    for t in range(N_FRAMES):
        yield from (form(t, k, y) for k, y in enumerate(offsets_m(t)))


def write_tables(folder: Path) -> None:
    """The tables, and the JSON lines."""
    usual = ("frame_id", "line", "offset_m")
    seconds = _per_line(lambda t, k, y: (f"{t / 10:.1f}", k, y))
    _rows(folder / "seconds.csv", ("timestamp", "id", "lateral"), seconds)
    # The frames from 50 to 59 are lost: a second.
    stamps = _per_line(lambda t, k, y: (START_NS + t * 10**8, k + 1, y))
    kept = (row for row in stamps if not 50 <= (row[0] - START_NS) // 10**8 < 60)
    _rows(folder / "nanoseconds.csv", ("stamp", "line", "offset_m"), kept)
    iso = _per_line(
        lambda t, k, y: (k + 1, round(-1000 * y), 0.9, "solid" if k in (0, 3) else "no")
    )
    heading = ("line", "lateral_mm", "confidence", "marking")
    dated = (
        (f"2026-03-01 12:00:{t // 10:02}.{t % 10}", *row)
        for t in range(N_FRAMES)
        for row in (next(iso) for _ in range(4))
    )
    _rows(folder / "iso8855.csv", ("when", *heading), dated)
    german = _per_line(lambda t, k, y: (t, k + 1, str(y).replace(".", ",")))
    _rows(folder / "semicolons.csv", ("Frame_ID", "line", "offset_m"), german, delimiter=";")
    _rows(folder / "tabs.tsv", usual, _per_line(lambda t, k, y: (t, k + 1, y)), delimiter="\t")
    nulls = _per_line(lambda t, k, y: (t, k + 1, "--" if (t, k) == (7, 2) else y))
    _rows(folder / "nulls.csv", usual, nulls)
    heads = [f"{side}_{name}" for side in ("left", "right") for name in ("c0", "quality", "type")]
    own = (
        (f"{t / 10:.1f}", y[1], 3, 0, y[2], 0 if t == 7 else 3, 1)
        for t in range(N_FRAMES)
        for y in [offsets_m(t)]
    )
    _rows(folder / "mobileye.csv", ("time", *heads), own)
    for name, message in (("openpilot", openpilot), ("own", own_message)):
        lines = [json.dumps(message(t)) for t in range(N_FRAMES)]
        (folder / f"{name}.jsonl").write_text("\n".join(lines) + "\n")
    inner = [openpilot(t)["modelV2"] for t in range(N_FRAMES)]
    pq.write_table(pa.Table.from_pylist(inner), folder / "openpilot.parquet")


def openpilot(frame: int) -> dict[str, Any]:
    """A line of an openpilot log that was written as JSON, 20 a second."""
    lines = [{"x": [0.0, 0.2], "y": [y, y]} for y in offsets_m(frame)]
    model = {
        "frameId": 500 + frame,
        "timestampEof": 10**12 + frame * 50_000_000,
        "laneLines": lines,
        "laneLineProbs": [0.9, 0.9, 0.9, 0.3],
        "roadEdges": [{"x": [0.0], "y": [-8.0]}, {"x": [0.0], "y": [5.4]}],
        "roadEdgeStds": [3.0, 0.2],
    }
    return {"logMonoTime": 10**12 + frame * 50_000_000, "valid": True, "modelV2": model}


def own_message(frame: int) -> dict[str, Any]:
    """A message of somebody's own: positive to the left."""
    lanes = [
        {"c0": -y, "confidence": 0.9, "is_solid": k in (0, 3)}
        for k, y in enumerate(offsets_m(frame))
    ]
    return {"header": header(frame), "lanes": lanes}


def header(frame: int) -> dict[str, Any]:
    """The header of a ROS message."""
    second, nano = divmod(START_NS + frame * 10**8, 10**9)
    return {"stamp": {"sec": second, "nanosec": nano}, "frame_id": "base_link"}


def write_bags(folder: Path) -> None:
    """Bags of ROS 2 (.mcap inside) with the messages that are usual there."""
    sides = (("left", 1), ("right", 2))
    per_side = [(t, side, offsets_m(t)[k]) for t in range(N_FRAMES) for side, k in sides]
    lka = "mobileye_560_660_msgs/msg/LkaLane"
    write_messages(
        folder / "lka",
        [
            (
                f"/parsed_tx/{side}_lka_lane",
                lka,
                t,
                {"header": header(t), "position_parameter_c0": y, "quality": 3, "lane_type": 0},
            )
            for t, side, y in per_side
        ],
    )
    path = "nav_msgs/msg/Path"
    write_messages(
        folder / "paths",
        [
            (
                f"/lane/{side}",
                path,
                t,
                {"header": header(t), "poses": [_pose(-y, x) for x in (-2, 5)]},
            )
            for t, side, y in per_side
        ],
    )
    markers = [
        {"action": 0, "points": [{"x": x, "y": -y} for x in (-2.0, 5.0)]} for y in offsets_m(0)
    ]
    write_messages(
        folder / "markers",
        [
            ("/markers", "visualization_msgs/msg/MarkerArray", t, {"markers": markers})
            for t in range(N_FRAMES)
        ],
    )
    models = []
    for t in range(N_FRAMES):
        lanes = [{"quality": 7, "marker_kind": 5, "marker_offset": -y} for y in offsets_m(t)]
        value = {"left_lane": lanes[1], "right_lane": lanes[2], "additional_lanes": lanes[::3]}
        value["header"] = header(t)
        models.append(("/models", "derived_object_msgs/msg/LaneModels", t, value))
    write_messages(folder / "models", models)


def _pose(y: float, x: float) -> dict[str, Any]:
    return {"pose": {"position": {"x": x, "y": y}}}


def write_messages(folder: Path, messages: Sequence[tuple[str, str, int, dict[str, Any]]]) -> None:
    """A bag of ROS 2 of messages: topic, type, frame and fields; those left out are zero."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in TYPES.items():
        store.register(get_types_from_msg(text, name))

    def made(name: str, value: dict[str, Any]) -> Any:
        fields = {}
        for field, (node, inner) in store.fielddefs[name][1]:
            fields[field] = filled(node, inner, value.get(field))
        return store.types[name](**fields)

    def filled(node: Nodetype, inner: Any, value: Any) -> Any:
        if node == Nodetype.NAME:
            return made(inner, value or {})
        if node == Nodetype.BASE:
            return ("" if inner[0] == "string" else 0) if value is None else value
        kind, name = inner[0]
        count = inner[1] if node == Nodetype.ARRAY else 0
        if kind == Nodetype.BASE:
            return np.zeros(count, dtype=name[0]) if name[0] != "string" else []
        return [made(name, each) for each in value or []]

    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Any] = {}
        for topic, kind, frame, value in messages:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            raw = bytes(store.serialize_cdr(made(kind, value), kind))
            bag.write(connections[topic], START_NS + frame * 10**8, raw)
