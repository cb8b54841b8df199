"""A result as an MCAP file for Foxglove and PlotJuggler.

Messages are JSON with a JSON Schema:

    /frame      the row of `Result.frames`: posteriors, answers, truth; without missing values
    /lines      frame_id and the lines as recorded: offset_m, is_valid, is_continuous, lri
    /birdseye   foxglove.SceneUpdate: the lines from above, the posterior as bars behind the car
    /changes    foxglove.Log: the reported lane changes
    /picture    foxglove.CompressedImage: the pictures that the detector saw

Foxglove's axes: x ahead, y to the left, z up.
"""

from __future__ import annotations

import base64
import heapq
import json
import math
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.export import chosen_frames
from egolane_pgm.result import Result, lanes_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import atomic
from egolane_pgm.types import SIDES, InputError, IntArray, LineLog
from egolane_pgm.vision.camera.pictures import images_of
from egolane_pgm.vision.camera.writing import as_jpeg
from egolane_pgm.vision.detectors.pictures import pictures_of

with needed("an .mcap file", "export"):
    from mcap.writer import Writer

Content = dict[str, Any]

#: A message: the row of its frame, its topic, its content.
Message = tuple[int, str, Content]

#: Nodes with more values (the cells of RoadPosition) are left out: each value is a curve.
MOST_VALUES = 16

#: How far ahead the lines of the bird's-eye view reach, and their dashes, metres.
AHEAD_M, DASH_M, WIDTH_M = 40.0, 3.0, 0.15

#: The bars of the posterior: position behind the camera, distance and greatest height, metres.
BARS_M, BAR_GAP_M, BAR_HEIGHT_M = -8.0, 2.0, 6.0

#: Pictures are not higher, pixels.
PICTURE_HEIGHT = 540

# Okabe and Ito's colours, red green blue.
CONTINUOUS, DASHED, NOT_VALID = (0, 114, 178), (230, 159, 0), (150, 150, 150)
ASSIGNED, OTHER, TRUTH, CAR = (0, 114, 178), (188, 215, 236), (213, 94, 0), (120, 120, 120)


def write_mcap(file: Path, result: Result, frames: tuple[int, int] | None = None) -> dict[str, int]:
    """Write a result as an MCAP file; return the number of messages of each topic.

    - frames: first and last frame id; all by default.

    Lines and pictures that are missing are left out with a warning. Raises InputError for several
    drives, for times that do not increase, and if the file cannot be written.
    """
    shown = chosen_frames(result, frames)
    time_ns = _clock(result, shown)
    log = next(iter(result.lines.values()), None)
    if log is None:
        warnings.warn(f"{result.name}: has no lines; shown without them", stacklevel=2)
    topics = [
        _frame_messages(result, shown),
        _line_messages(log, shown),
        _scene_messages(log, shown, time_ns),
        _event_messages(result, shown, time_ns),
        _picture_messages(result, shown, time_ns),
    ]
    counts: Counter[str] = Counter()
    with atomic(file) as temporary, temporary.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="", library="egolane-pgm")
        channels: dict[str, int] = {}
        for row, topic, content in heapq.merge(*topics, key=lambda message: message[0]):
            if topic not in channels:
                channels[topic] = _channel(writer, topic, content)
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            now = int(time_ns[row])
            writer.add_message(channels[topic], now, data, now, row)
            counts[topic] += 1
        writer.finish()
    return dict(counts)


def _clock(result: Result, frames: pd.DataFrame) -> IntArray:
    """(T,): the times of the frames, nanoseconds; they must increase."""
    time_s = frames["time_s"].to_numpy(np.float64)
    # Seconds since 1970 in a float are exact to a microsecond.
    time_ns: IntArray = np.round(time_s * 1e6).astype(np.int64) * 1000
    bad = (np.diff(time_ns, prepend=-1) <= 0) | (time_ns < 0)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(
            f"{result.directory or result.name}: frame {frames.index[k]} is at {time_s[k]:g} s,"
            " before 0 or not after the frame before it; a viewer needs times that increase"
        )
    return time_ns


def _channel(writer: Any, topic: str, first: Content) -> int:
    """Register a topic, whose messages are like the first one."""
    name, example = SCHEMAS.get(topic, (f"egolane{topic.replace('/', '.')}", first))
    schema = json.dumps({"title": name, **schema_of(example)}).encode()
    schema_id = writer.register_schema(name, "jsonschema", schema)
    return int(writer.register_channel(topic, "json", schema_id))


def schema_of(example: Any) -> Content:
    """The JSON Schema of values like an example. A list is described by its first element, a
    number that may be unknown by None."""
    if isinstance(example, dict):
        return {"type": "object", "properties": {k: schema_of(v) for k, v in example.items()}}
    if isinstance(example, list):
        return {"type": "array", "items": schema_of(example[0]) if example else {}}
    if isinstance(example, bytes):
        return {"type": "string", "contentEncoding": "base64"}
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string"}
    return {"type": kinds.get(type(example), ["number", "null"])}


# --- messages ------------------------------------------------------------------------------------


def _frame_messages(result: Result, frames: pd.DataFrame) -> Iterator[Message]:
    many = {node: len(values) for node, values in result.run["values"].items()}
    left_out = tuple(f"{node}_" for node, n in many.items() if n > MOST_VALUES)
    table = frames.reset_index()
    table = table[[column for column in table if not column.startswith(left_out)]]
    for row, record in enumerate(table.to_dict("records")):
        yield row, "/frame", {key: value for key, value in record.items() if _is_known(value)}


def _is_known(value: Any) -> bool:
    return math.isfinite(value) if isinstance(value, float) else value is not None


def _line_messages(log: LineLog | None, frames: pd.DataFrame) -> Iterator[Message]:
    """The lines in the form that `egolane online` and `recordings.topics` read."""
    for row, at in _rows(log, frames):
        assert log is not None
        columns = log.offset_m[at], log.is_valid[at], log.is_continuous[at], log.lri[at]
        lines = [
            {
                "offset_m": offset if math.isfinite(offset) else None,
                "is_valid": is_valid,
                "is_continuous": is_continuous,
                "lri": lri if math.isfinite(lri) else None,
            }
            for offset, is_valid, is_continuous, lri in zip(
                *(column.tolist() for column in columns), strict=True
            )
            if not (math.isnan(offset) and math.isnan(lri))
        ]
        yield row, "/lines", {"frame_id": int(frames.index[row]), "lines": lines}


def _rows(log: LineLog | None, frames: pd.DataFrame) -> Iterator[tuple[int, int]]:
    """The row of each frame, and the row of its lines."""
    if log is not None:
        at = pd.Index(log.frame_id).get_indexer(frames.index)
        yield from ((row, int(at[row])) for row in np.flatnonzero(at >= 0).tolist())


def _scene_messages(
    log: LineLog | None, frames: pd.DataFrame, time_ns: IntArray
) -> Iterator[Message]:
    """The lines straight ahead, since a recording has their offsets only, and the posterior."""
    posterior, answer = lanes_of(frames), frames["assigned_lane"].to_numpy()
    truth = frames["true_lane"].fillna(0).to_numpy(int)
    lines_at = dict(_rows(log, frames))
    for row, now in enumerate(time_ns.tolist()):
        lines: list[Content] = []
        if log is not None and row in lines_at:
            at = lines_at[row]
            # Some detectors write an offset of exactly 0, or of kilometres, for no line.
            offset = np.abs(log.offset_m[at])
            is_line = (offset < 100) & ((offset > 0) | log.is_valid[at])
            for k in np.flatnonzero(is_line):
                valid, solid = bool(log.is_valid[at, k]), bool(log.is_continuous[at, k])
                lines.append(_line(-float(log.offset_m[at, k]), valid, solid))
        cubes = [_cube((-2.25, 0.0, 0.7), (4.5, 1.8, 1.4), CAR)]
        n = posterior.shape[1]
        for lane, p in enumerate(posterior[row].tolist(), start=1):
            left, high = ((n + 1) / 2 - lane) * BAR_GAP_M, max(p * BAR_HEIGHT_M, 0.02)
            colour = ASSIGNED if lane == answer[row] else OTHER
            cubes.append(_cube((BARS_M, left, high / 2), (0.8, 1.6, high), colour))
            if lane == truth[row]:
                cubes.append(_cube((BARS_M, left, -0.05), (1.4, 1.9, 0.1), TRUTH))
        yield row, "/birdseye", _scene(now, lines, cubes)


def _event_messages(result: Result, frames: pd.DataFrame, time_ns: IntArray) -> Iterator[Message]:
    for event in result.events.to_dict("records"):
        row = int(frames.index.searchsorted(event["detected_frame_id"]))
        if row < len(frames) and event["detected_frame_id"] >= frames.index[0]:
            text = f"lane change {SIDES[event['direction']]}"
            if event["from_lane"]:
                text += f", from {event['from_lane']} to {event['to_lane']}"
                text += f", probability {event['probability']:.2f}"
            yield row, "/changes", _log(int(time_ns[row]), text)


def _picture_messages(result: Result, frames: pd.DataFrame, time_ns: IntArray) -> Iterator[Message]:
    """The pictures as JPEG files. The detector is not run again."""
    if result.experiment.recording.detector is None:
        return
    ids = frames.index
    try:
        source = pictures_of(result.experiment, "path")
    except InputError as error:
        warnings.warn(f"shown without pictures: {error}", stacklevel=2)
        return
    for frame_id, _, image in images_of(source, (int(ids[0]), int(ids[-1]) + 1)):
        if frame_id in ids:
            row = int(ids.get_loc(frame_id))
            data = base64.b64encode(as_jpeg(image, PICTURE_HEIGHT)).decode()
            stamp = _time(int(time_ns[row]))
            content = {"timestamp": stamp, "frame_id": "camera", "format": "jpeg", "data": data}
            yield row, "/picture", content


# --- Foxglove's schemas --------------------------------------------------------------------------


def _scene(now: int, lines: list[Content], cubes: list[Content]) -> Content:
    empty = ("arrows", "spheres", "cylinders", "triangles", "models", "texts", "metadata")
    entity = {
        "timestamp": _time(now),
        "frame_id": "car",
        "id": "drive",
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "lines": lines,
        "cubes": cubes,
        **{name: [] for name in empty},
    }
    return {"deletions": [], "entities": [entity]}


def _line(left: float, is_valid: bool, is_continuous: bool) -> Content:
    step = AHEAD_M if is_continuous else DASH_M
    starts = np.arange(0.0, AHEAD_M, 2 * step).tolist()
    ends = [x for start in starts for x in (start, min(start + step, AHEAD_M))]
    colour = NOT_VALID if not is_valid else CONTINUOUS if is_continuous else DASHED
    return {
        "type": 2,  # every two points are a segment
        "pose": _pose((0.0, 0.0, 0.0)),
        "thickness": WIDTH_M if is_valid else WIDTH_M / 2,
        "scale_invariant": False,
        "points": [{"x": x, "y": left, "z": 0.0} for x in ends],
        "color": _colour(colour),
        "colors": [],
        "indices": [],
    }


def _cube(
    at: tuple[float, float, float], size: tuple[float, float, float], colour: tuple[int, int, int]
) -> Content:
    sizes = dict(zip("xyz", size, strict=True))
    return {"pose": _pose(at), "size": sizes, "color": _colour(colour)}


def _pose(at: tuple[float, float, float]) -> Content:
    orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {"position": dict(zip("xyz", at, strict=True)), "orientation": orientation}


def _colour(colour: tuple[int, int, int]) -> Content:
    return {**{key: value / 255 for key, value in zip("rgb", colour, strict=True)}, "a": 1.0}


def _time(now: int) -> Content:
    return {"sec": now // 10**9, "nsec": now % 10**9}


def _log(now: int, text: str) -> Content:
    level = {"level": 2, "name": "egolane", "file": "", "line": 0}  # 2: information
    return {"timestamp": _time(now), "message": text, **level}


_ORIGIN = (0.0, 0.0, 0.0)
_LINE = {"offset_m": None, "is_valid": True, "is_continuous": True, "lri": None}

#: Names of schemas, and examples with all keys, which the first message may lack.
SCHEMAS: dict[str, tuple[str, Content]] = {
    "/lines": ("egolane.lines", {"frame_id": 0, "lines": [_LINE]}),
    "/birdseye": (
        "foxglove.SceneUpdate",
        _scene(0, [_line(0.0, True, True)], [_cube(_ORIGIN, _ORIGIN, CAR)]),
    ),
    "/changes": ("foxglove.Log", _log(0, "")),
    "/picture": (
        "foxglove.CompressedImage",
        {"timestamp": _time(0), "frame_id": "camera", "format": "jpeg", "data": b""},
    ),
}
