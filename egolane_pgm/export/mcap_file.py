"""A result as an MCAP file for Foxglove and PlotJuggler.

Messages are JSON with a JSON Schema:

    /frame      the row of `Result.frames`: posteriors, answers, truth; without missing values
    /lines      frame_id and the lines as recorded: offset_m, is_valid, is_continuous, lri
    /changes    the row of `Result.events`: a reported lane change
    /picture    foxglove.CompressedImage: the pictures that the detector saw
"""

from __future__ import annotations

import base64
import heapq
import json
import math
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.export import chosen_frames
from egolane_pgm.result import Result
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import atomic
from egolane_pgm.types import InputError, IntArray
from egolane_pgm.vision.camera.pictures import images_of
from egolane_pgm.vision.camera.writing import as_jpeg
from egolane_pgm.vision.detectors.pictures import pictures_of

with needed("an .mcap file", "mcap"):
    from mcap.writer import Writer

Content = dict[str, Any]

#: A message: the row of its frame, its topic, its content.
Message = tuple[int, str, Content]

#: Nodes with more values (the cells of RoadPosition) are left out: each value is a curve.
MOST_VALUES = 16

#: Pictures are not higher, pixels.
PICTURE_HEIGHT = 540

#: The names of Foxglove's schemas.
SCHEMAS = {"/picture": "foxglove.CompressedImage"}


def write_mcap(file: Path, result: Result, frames: tuple[int, int] | None = None) -> None:
    """Write a result as an MCAP file.

    - frames: first and last frame id; all by default.

    Lines and pictures that are missing are left out with a warning. Raises InputError for several
    drives, and if the file cannot be written.
    """
    shown = chosen_frames(result, frames)
    # Seconds since 1970 in a float are exact to a microsecond.
    time_ns = (shown["time_s"] * 1e6).round().astype(np.int64).to_numpy() * 1000
    if not result.lines:
        warnings.warn(f"{result.name}: has no lines; the file shows the rest", stacklevel=2)
    topics = [
        _frame_messages(result, shown),
        _line_messages(result, shown),
        _event_messages(result, shown),
        _picture_messages(result, shown, time_ns),
    ]
    with atomic(file) as temporary, temporary.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="", library="egolane-pgm")
        channels: dict[str, int] = {}
        for row, topic, content in heapq.merge(*topics, key=lambda message: message[0]):
            if topic not in channels:
                channels[topic] = _channel(writer, topic, content)
            data = json.dumps(content, default=_base64, allow_nan=False).encode()
            now = int(time_ns[row])
            writer.add_message(channels[topic], now, data, now, row)
        writer.finish()


def _channel(writer: Any, topic: str, first: Content) -> int:
    """Register a topic, whose messages are like the first one."""
    name = SCHEMAS.get(topic, f"egolane{topic.replace('/', '.')}")
    schema = json.dumps({"title": name, **schema_of(first)}).encode()
    schema_id = writer.register_schema(name, "jsonschema", schema)
    return int(writer.register_channel(topic, "json", schema_id))


def schema_of(example: Any) -> Content:
    """The JSON Schema of values like an example; a list is described by its first element."""
    if isinstance(example, dict):
        return {"type": "object", "properties": {k: schema_of(v) for k, v in example.items()}}
    if isinstance(example, list):
        return {"type": "array", "items": schema_of(example[0]) if example else {}}
    if isinstance(example, bytes):
        return {"type": "string", "contentEncoding": "base64"}
    kinds = {bool: "boolean", int: "integer", str: "string"}
    return {"type": kinds.get(type(example), ["number", "null"])}


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


# --- messages ------------------------------------------------------------------------------------


def _frame_messages(result: Result, frames: pd.DataFrame) -> Iterator[Message]:
    many = {node: len(values) for node, values in result.run["values"].items()}
    left_out = tuple(f"{node}_" for node, n in many.items() if n > MOST_VALUES)
    columns = [column for column in frames if not column.startswith(left_out)]
    return _records("/frame", frames[columns].reset_index(), range(len(frames)))


def _event_messages(result: Result, frames: pd.DataFrame) -> Iterator[Message]:
    events = result.events[result.events["detected_frame_id"].isin(frames.index)]
    return _records("/changes", events, frames.index.get_indexer(events["detected_frame_id"]))


def _records(topic: str, table: pd.DataFrame, rows: Iterable[int]) -> Iterator[Message]:
    """A message for each row of a table, without missing and infinite values."""
    for row, record in zip(rows, table.to_dict("records"), strict=True):
        known = {k: v for k, v in record.items() if v is not None and math.isfinite(v)}
        yield int(row), topic, known


def _lines_of(result: Result) -> dict[int, list[Content]]:
    """The lines as recorded, by frame id; a missing number is None."""
    found: dict[int, list[Content]] = {}
    for log in result.lines.values():
        table = log.to_pandas()[["offset_m", "is_valid", "is_continuous", "lri"]]
        table = table.dropna(subset=["offset_m", "lri"], how="all").astype(object)
        found = {frame_id: [] for frame_id in log.frame_id.tolist()}
        records = table.where(table.notna(), None).to_dict("records")
        for (frame_id, _), line in zip(table.index, records, strict=True):
            found[frame_id].append(line)
    return found


def _line_messages(result: Result, frames: pd.DataFrame) -> Iterator[Message]:
    """The lines in the form that `egolane online` and `recordings.topics` read."""
    lines = _lines_of(result)
    for row, frame_id in enumerate(frames.index):
        if frame_id in lines:
            yield row, "/lines", {"frame_id": int(frame_id), "lines": lines[frame_id]}


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
    for frame_id, _, (image,) in images_of((source,), (int(ids[0]), int(ids[-1]) + 1)):
        if frame_id in ids:
            row = int(ids.get_loc(frame_id))
            now = int(time_ns[row])
            time = {"sec": now // 10**9, "nsec": now % 10**9}
            content: Content = {"timestamp": time, "frame_id": "camera"}
            content |= {"format": "jpeg", "data": as_jpeg(image, PICTURE_HEIGHT)}
            yield row, "/picture", content
