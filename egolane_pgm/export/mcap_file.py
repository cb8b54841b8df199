"""A drive as an MCAP file for Foxglove and PlotJuggler.

Messages are JSON with a JSON Schema. What has a place in space or is a picture is of Foxglove's
well-known schemas (foxglove.SceneUpdate, CompressedImage, Log); all that is a number is a plain
object, of which both programs draw every number over time:

    /belief     the columns of beliefs.parquet for the belief of each hidden node (Lane_1, ...)
    /lanes      model, detector, truth: the lanes that are answered and annotated; 0: none
    /detector   the detector's own answer (detector_1, ...)
    /frame      frame_id, log_evidence, is_impossible; crossing where the graph has RoadPosition
    /lines      frame_id and the lines as recorded: offset_m, is_valid, is_continuous, lri
    /birdseye   the lines seen from above, and the belief over the lanes as bars behind the car
    /changes    the lane changes that are reported
    /picture    the pictures, as JPEG

Foxglove's axes: x ahead, y to the left, z up.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from egolane_pgm.export.drive import (
    AHEAD_M,
    BAR_GAP_M,
    BAR_HEIGHT_M,
    BARS_M,
    TRUTH,
    Colour,
    Drive,
)
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import atomic
from egolane_pgm.types import LineLog

with needed("an .mcap file", "export"):
    from mcap.writer import Writer

Content = dict[str, Any]

#: The frame of reference of what has a place: the car's.
_CAR = "car"

_Point = tuple[float, float, float]

#: The length of a dash and of the gap behind it, and the width of a line, metres.
_DASH_M, _WIDTH_M = 3.0, 0.15


def write_mcap(path: Path, drive: Drive) -> dict[str, int]:
    """Write a drive; returns the number of messages per topic. Raises InputError where the
    file cannot be written or a picture cannot be read."""
    counts: dict[str, int] = {}
    channels: dict[str, int] = {}
    pictures = drive.jpegs()
    upcoming = next(pictures, None)
    with atomic(path) as temporary, temporary.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="", library="egolane-pgm")
        writer.add_metadata(
            "egolane", {"name": drive.result.name, "directory": str(drive.result.directory)}
        )
        texts = drive.event_texts()
        for t, now in enumerate(drive.time_ns.tolist()):
            messages = list(_messages(drive, t, now))
            messages += [("/changes", _log(now, text)) for row, text in texts if row == t]
            while upcoming is not None and upcoming[0] <= t:
                if upcoming[0] == t:
                    messages.append(("/picture", _picture(now, upcoming[1])))
                upcoming = next(pictures, None)
            for topic, content in messages:
                if topic not in channels:
                    channels[topic] = _channel(writer, topic, content)
                data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
                writer.add_message(channels[topic], now, data, now, t)
                counts[topic] = counts.get(topic, 0) + 1
        writer.finish()
    return counts


def _channel(writer: Writer, topic: str, first: Content) -> int:
    """A channel of messages like the first one."""
    name, example = _KNOWN.get(topic, (f"egolane{topic.replace('/', '.')}", first))
    schema = json.dumps({"title": name, **schema_of(example)})
    schema_id = writer.register_schema(name, "jsonschema", schema.encode())
    return int(writer.register_channel(topic, "json", schema_id))


def schema_of(example: Any) -> Content:
    """The JSON Schema of messages that have the keys and kinds of values of an example. A list is
    of what its first element is, or of objects; None stands for a number that may be unknown."""
    if isinstance(example, dict):
        properties = {key: schema_of(value) for key, value in example.items()}
        return {"type": "object", "properties": properties, "required": list(properties)}
    if isinstance(example, list):
        return {"type": "array", "items": schema_of(example[0]) if example else {"type": "object"}}
    if example is None:
        return {"type": ["number", "null"]}
    if isinstance(example, bytes):
        return {"type": "string", "contentEncoding": "base64"}
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string"}
    return {"type": kinds[type(example)]}


def _messages(drive: Drive, t: int, now: int) -> Iterator[tuple[str, Content]]:
    result = drive.result
    yield (
        "/belief",
        {
            f"{node}_{name}": float(belief[t, k])
            for node, (names, belief) in drive.beliefs().items()
            for k, name in enumerate(names)
        },
    )
    yield "/lanes", {name: int(lane[t]) for name, lane in drive.lane_curves().items()}
    if result.tentative is not None:
        yield (
            "/detector",
            {f"detector_{k + 1}": float(p) for k, p in enumerate(result.tentative[t])},
        )
    frame = {
        "frame_id": int(result.frame_id[t]),
        "log_evidence": float(result.log_evidence[t]),
        "is_impossible": bool(result.is_impossible[t]),
        "is_crossing": bool(result.is_crossing[t]),
    }
    if result.crossing is not None:
        frame["crossing"] = float(result.crossing[t])
    yield "/frame", frame
    if drive.result.lines is not None:
        # As `egolane online` takes them, and `recordings.topics` reads them again.
        number = int(result.frame_id[t])
        yield "/lines", {"frame_id": number, "lines": _recorded(drive.result.lines, t)}
    yield "/birdseye", _scene(drive, t, now)


def _recorded(log: LineLog, t: int) -> list[Content]:
    """The lines of frame t as recorded, without the padding."""
    offset, lri = log.offset_m[t], log.lri[t]
    return [
        {
            "offset_m": float(offset[k]) if abs(offset[k]) < float("inf") else None,
            "is_valid": bool(log.is_valid[t, k]),
            "is_continuous": bool(log.is_continuous[t, k]),
            "lri": float(lri[k]) if lri[k] == lri[k] else None,
        }
        for k in range(len(offset))
        if offset[k] == offset[k] or lri[k] == lri[k]
    ]


# --- Foxglove's schemas --------------------------------------------------------------------------


def _scene(drive: Drive, t: int, now: int) -> Content:
    lines = [
        _line(-offset, colour, is_dashed=not is_solid, is_thin=not is_valid)
        for offset, colour, is_valid, is_solid in drive.lines_at(t)
    ]
    cubes, texts = [_cube((-2.25, 0.0, 0.7), (4.5, 1.8, 1.4), (120, 120, 120))], []
    for k, (right, belief, colour, is_true) in enumerate(drive.bars_at(t)):
        high = max(belief * BAR_HEIGHT_M, 0.02)
        cubes.append(_cube((BARS_M, -right, high / 2), (0.8, 0.8 * BAR_GAP_M, high), colour))
        if is_true:
            cubes.append(_cube((BARS_M, -right, -0.05), (1.4, 0.95 * BAR_GAP_M, 0.1), TRUTH))
        label = f"lane {k + 1}: {belief:.2f}" + (", true" if is_true else "")
        texts.append(_text((BARS_M - 1.5, -right, 0.2), label))
    return _entity(now, lines, cubes, texts)


def _entity(now: int, lines: list[Content], cubes: list[Content], texts: list[Content]) -> Content:
    nothing = ("arrows", "spheres", "cylinders", "triangles", "models", "metadata")
    entity = {
        "timestamp": _time(now),
        "frame_id": _CAR,
        "id": "drive",
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "lines": lines,
        "cubes": cubes,
        "texts": texts,
        **{name: [] for name in nothing},
    }
    return {"deletions": [], "entities": [entity]}


def _line(left: float, colour: Colour, *, is_dashed: bool, is_thin: bool) -> Content:
    step = _DASH_M if is_dashed else AHEAD_M
    starts = [2 * step * k for k in range(int(AHEAD_M // (2 * step)) + 1)]
    ends = [x for start in starts for x in (start, min(start + step, AHEAD_M))]
    return {
        "type": 2,  # each two points are a piece of their own
        "pose": _pose((0.0, 0.0, 0.0)),
        "thickness": _WIDTH_M / 2 if is_thin else _WIDTH_M,
        "scale_invariant": False,
        "points": [{"x": float(x), "y": left, "z": 0.0} for x in ends],
        "color": _colour(colour),
        "colors": [],
        "indices": [],
    }


def _cube(at: _Point, size: _Point, colour: Colour) -> Content:
    return {"pose": _pose(at), "size": _xyz(size), "color": _colour(colour)}


def _text(at: _Point, text: str) -> Content:
    return {
        "pose": _pose(at),
        "billboard": True,
        "font_size": 0.5,
        "scale_invariant": False,
        "color": _colour((255, 255, 255)),
        "text": text,
    }


def _pose(at: _Point) -> Content:
    return {"position": _xyz(at), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _xyz(at: _Point) -> Content:
    return dict(zip("xyz", at, strict=True))


def _colour(colour: Colour) -> Content:
    red, green, blue = (value / 255 for value in colour)
    return {"r": red, "g": green, "b": blue, "a": 1.0}


def _time(now: int) -> Content:
    return {"sec": now // 10**9, "nsec": now % 10**9}


def _log(now: int, text: str) -> Content:
    # Level 2 is what is worth knowing.
    said = {"timestamp": _time(now), "level": 2, "message": text, "name": "egolane"}
    return {**said, "file": "", "line": 0}


def _picture(now: int, jpeg: bytes) -> Content:
    data = base64.b64encode(jpeg).decode()
    return {"timestamp": _time(now), "frame_id": "camera", "data": data, "format": "jpeg"}


#: The names of Foxglove's schemas, and an example of what has lists, which the first message may
#: leave empty.
_ORIGIN = (0.0, 0.0, 0.0)
_KNOWN: dict[str, tuple[str, Content]] = {
    "/birdseye": (
        "foxglove.SceneUpdate",
        _entity(
            0,
            [_line(0.0, TRUTH, is_dashed=True, is_thin=False)],
            [_cube(_ORIGIN, _ORIGIN, TRUTH)],
            [_text(_ORIGIN, "")],
        ),
    ),
    "/changes": ("foxglove.Log", _log(0, "")),
    "/picture": ("foxglove.CompressedImage", {**_picture(0, b""), "data": b""}),
    "/lines": (
        "egolane.lines",
        {
            "frame_id": 0,
            "lines": [{"offset_m": None, "is_valid": True, "is_continuous": True, "lri": None}],
        },
    ),
}
