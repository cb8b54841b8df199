"""Looks at a recording that nobody described: what is in it, which fields may be lines, and the
mapping that would read them. It only proposes; what is run is what the user then says."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from egolane_pgm.experiment import LinesMapping
from egolane_pgm.recordings import containers
from egolane_pgm.recordings.cells import arrow_column
from egolane_pgm.recordings.fields import Table
from egolane_pgm.recordings.mapping import (
    LinesGiven,
    columns_of,
    contradictions,
    lines_of,
    lines_of_table,
    mapping_keys,
    mapping_of,
    presets,
)
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.table import TABLES, read_columns
from egolane_pgm.types import InputError, LineLog

#: Messages of a topic that are looked at.
LOOKED_AT = 2000

#: Lanes are this wide, metres; the widths of the lanes that a unit would give are compared with it.
_WIDTH_M = (2.2, 5.0)

#: Names by which fields are known, the likeliest first.
_OFFSET = ("offset", "lateral", r"(^|_)c0$", "position", "dist", r"(^|_)y0?$")
_TIME = r"time|stamp|^t$|sec"
_LINE = r"^(line|lane)_?(id|nr|no|number|index)$"
_FRAME = r"^(frame|seq|image|cycle)"
_VALID = r"valid|conf|prob|qual|score"
_CONTINUOUS = r"solid|contin|type|kind|style|marker|class"

#: Steps between frames, seconds, by which the unit of time stamps is told.
_STEP_S = (0.004, 3.0)

#: Topics of these types are a line each.
_LINE_TYPES = {"Path": "path", "LkaLane": "mobileye"}


@dataclass(frozen=True)
class _Leaf:
    """A field that holds values: the span of numbers, or some of the texts."""

    path: str
    type: str
    low: float | None = None
    high: float | None = None
    texts: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The last part of the path, in small letters."""
        return re.sub(r"\[.*?\]", "", self.path.rpartition(".")[2]).lower()


_Read = Callable[[LinesMapping], LineLog]


def look_into(
    path: Path, given: LinesGiven | None = None, definitions: str | Path | None = None
) -> dict[str, Any]:
    """What is in a recording.

    - given: the mapping that is looked through, in place of a guess.
    - definitions: of a log's messages, see `recordings.containers`.

    Returns the file, its topics with their fields, and, where lines were found, their mapping
    (`lines`), frames, rate, gaps, span and what is odd about their signs.
    Raises InputError for a file that cannot be read.
    """
    keys = {} if given is None else mapping_keys(given)
    if given is None and path.suffix.lower() == ".csv" and path.is_file():
        keys = _separators(path)
    tables, read, try_out = _tables(path, mapping_of(keys, str(path)), definitions)
    leaves = {topic: list(_leaves(table)) for topic, (_, _, table) in tables.items()}
    found: dict[str, Any] = {
        "file": str(path),
        "topics": [
            {"topic": topic, "type": kind, "messages": count, "fields": [*map(vars, leaves[topic])]}
            for topic, (kind, count, _) in tables.items()
        ],
        "lines": None,
    }
    if given is not None:
        return found | {"lines": keys, **_said(read(mapping_of(keys, str(path))))}
    for guess in _guesses(tables, leaves):
        guess = {**keys, **guess}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                log = try_out(mapping_of(guess, str(path)))
        except InputError as error:
            found.setdefault("problem", str(error))
            continue
        if log.is_valid.sum() >= len(log) / 2:
            guess |= _unit_and_sign(log, guess)
            found.pop("problem", None)
            return found | {"lines": guess, **_said(read(mapping_of(guess, str(path))))}
    return found


def _tables(
    path: Path, keys: LinesMapping, definitions: str | Path | None
) -> tuple[dict[str, tuple[str, int | None, Table]], _Read, _Read]:
    """Of each topic the type, the number of messages and the first of them as a table; and what
    reads the lines of the file, and those of the first messages."""
    if path.suffix.lower() in TABLES:
        table = read_columns(path, keys)
        columns = dict(zip(table.column_names, table.columns, strict=True))
        one = Table(columns, table.num_rows, path)
        read = partial(lines_of_table, columns, path=path)
        return {"": ("table", table.num_rows, one)}, read, read
    tables, kept = {}, []
    for topic, (kind, count) in containers.topics_of(path, definitions=definitions).items():
        if count == 0 or "Image" in kind:
            continue
        fields: dict[str, Any] = {}
        # A topic that cannot be read must not hide the others.
        with contextlib.suppress(InputError):
            some = containers.messages(path, [topic], definitions=definitions)
            messages = [*islice(some, LOOKED_AT)]
            fields = columns_of([message.value for message in messages], str(path))
            kept += messages
        tables[topic] = (kind, count, Table(fields, min(count or LOOKED_AT, LOOKED_AT), path))

    def read_all(mapping: LinesMapping) -> LineLog:
        lines = mapping if mapping.model_fields_set else None
        return containers.read_messages(path, lines=lines, definitions=definitions)

    def read_some(mapping: LinesMapping) -> LineLog:
        return lines_of(kept, mapping, str(path)) if mapping.model_fields_set else read_all(mapping)

    return tables, read_all, read_some


def _leaves(table: Table) -> Iterator[_Leaf]:
    def below(path: str, values: Any) -> Iterator[_Leaf]:
        kind = values.type
        if pa.types.is_struct(kind):
            for field in kind:
                yield from below(f"{path}.{field.name}", pc.struct_field(values, field.name))
        elif pa.types.is_nested(kind):
            yield from below(f"{path}[]", pc.list_flatten(values))
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind):
            span = pc.min_max(values).as_py()
            yield _Leaf(path, str(kind), span["min"], span["max"])
        else:
            texts = pc.unique(values)[:3].to_pylist()
            yield _Leaf(path, str(kind), texts=tuple(str(t)[:40] for t in texts if t is not None))

    for name, column in table.columns.items():
        yield from below(name, arrow_column(column))


def _separators(path: Path) -> dict[str, Any]:
    """The separator and the decimal point of a CSV, by its first rows."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        rows = [*islice(file, 20)]
    found = max(",;\t|", key=rows[0].count) if rows else ","
    cells = {cell.strip() for row in rows[1:] for cell in row.split(found)}
    keys = {} if found == "," else {"separator": found.replace("\t", "\\t")}
    if found != "," and any(re.fullmatch(r"[-+]?\d+,\d+", cell) for cell in cells):
        keys["decimal"] = ","
    return keys


# --- guesses -------------------------------------------------------------------------------------


def _guesses(
    tables: Mapping[str, tuple[str, int | None, Table]], leaves: Mapping[str, list[_Leaf]]
) -> Iterator[dict[str, Any]]:
    """Mappings that may read the lines, the likeliest first."""
    yield {}
    for topic, (kind, _, table) in tables.items():
        frames = _frames(leaves[topic], table)
        where = {"topic": topic} if topic and len(tables) > 1 else {}
        other = re.sub("left", "right", topic, flags=re.I)
        preset = _LINE_TYPES.get(kind.rpartition("/")[2])
        if preset and topic != other and other in tables:
            yield {"preset": preset, "topic": re.sub("left", "{}", topic, flags=re.I)}
        for name, keys in presets().items():
            added = frames if not topic and not {"time", "frame_id"} & {*keys} else {}
            yield {"preset": name, **({} if "topic" in keys else where), **added}
    for topic, each in _alike(tables).items():
        first = topic.replace("{}", each[0])
        for keys in _by_names(leaves[first], tables[first][2]):
            yield {"topic": topic, "each": each, **keys}
    for topic, (_, _, table) in tables.items():
        where = {"topic": topic} if topic and len(tables) > 1 else {}
        for keys in _by_names(leaves[topic], table):
            yield {**where, **keys}


def _alike(topics: Iterable[str]) -> dict[str, list[str]]:
    """Topics that differ in a number or a side, as `{}`, and what stands there."""
    found: dict[str, list[str]] = {}
    for topic in topics:
        for match in re.finditer(r"\d+|left|right", topic, re.I):
            found.setdefault(f"{topic[: match.start()]}{{}}{topic[match.end() :]}", []).append(
                match[0]
            )
    return {
        name: sorted(each, key=lambda k: (len(k), k)) for name, each in found.items() if each[1:]
    }


def _named(pattern: str, among: list[_Leaf]) -> list[_Leaf]:
    return [leaf for leaf in among if re.search(pattern, leaf.name)]


def _frames(leaves: list[_Leaf], table: Table) -> dict[str, Any]:
    """Which fields may be frame id and time, where none have our own names."""
    at_root = [leaf for leaf in leaves if "[]" not in leaf.path and leaf.low is not None]
    found: dict[str, Any] = {}
    if table.own("frame_id") is None:
        for leaf in _named(_FRAME, at_root)[:1]:
            found["frame_id"] = leaf.path
    for leaf in leaves if table.own("time_s") is None else []:
        if leaf.type.startswith("timestamp"):
            return found | {"time": leaf.path}
    for leaf in _named(_TIME, at_root) if table.own("time_s") is None else []:
        if any(table.has(f"{_place(leaf.path)}.{name}") for name in ("nanosec", "nsec", "nanos")):
            return found | {"time": _place(leaf.path)}
        found |= _time_of(table, leaf.path)
    for leaf in _named(_LINE, at_root) if table.own("line") is None else []:
        found["line"] = leaf.path
    return found


def _by_names(leaves: list[_Leaf], table: Table) -> Iterator[dict[str, Any]]:
    """Mappings of a table by the names and values of its fields."""
    frames = _frames(leaves, table)
    for pattern in _OFFSET:
        for leaf in _named(pattern, leaves):
            if leaf.low is None or not leaf.low < leaf.high <= 1e5:  # type: ignore[operator]
                continue
            side = re.search("left|right", leaf.path, re.I)
            each = {}
            word = "" if side is None else side[0]
            if word:
                each = {"each": ("left", "right") if word.islower() else ("Left", "Right")}
            beside = [o for o in leaves if _place(o.path) == _place(leaf.path) and word in o.path]
            keys = {"offset": leaf.path, **_flags(beside)}
            named = {key: said.replace(word, "{}") if word else said for key, said in keys.items()}
            yield {**frames, **named, **each}


def _place(path: str) -> str:
    return path.rpartition(".")[0]


def _time_of(table: Table, path: str) -> dict[str, Any]:
    """A field as time, with the unit by which its steps are those of a camera."""
    values = arrow_column(table.values("time", path)[1]).drop_null()
    step = np.diff(values.to_numpy(zero_copy_only=False))
    later = step[step > 0]
    if not len(later) or (step < 0).any():
        return {}
    for unit, per in (("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if _STEP_S[0] < np.median(later) / per < _STEP_S[1]:
            return {"time": path} | ({} if unit == "s" else {"time_unit": unit})
    return {}


def _flags(beside: list[_Leaf]) -> dict[str, str]:
    """Conditions on the fields beside an offset."""
    found = {}
    for leaf in _named(_VALID, beside)[:1]:
        if leaf.type == "bool":
            found["is_valid"] = leaf.path
        elif leaf.high is not None:
            found["is_valid"] = f"{leaf.path} " + ("> 0.5" if leaf.high <= 1 else ">= 2")
    for leaf in _named(_CONTINUOUS, beside):
        solid = [text for text in leaf.texts if re.search("solid|double|edge|curb", text, re.I)]
        if leaf.type == "bool" or ("solid" in leaf.name and leaf.high == 1):
            found["is_continuous"] = leaf.path
        elif solid:
            found["is_continuous"] = f"{leaf.path} in [{', '.join(solid)}]"
    return found


def _unit_and_sign(log: LineLog, keys: Mapping[str, Any]) -> dict[str, Any]:
    """The unit in which the lanes are as wide as lanes are, and the sign by which lines that have
    an order go from left to right."""
    offset = np.sort(np.where(log.is_valid, log.offset_m, np.nan), axis=1)
    gap = np.diff(offset, axis=1)
    width = float(np.nanmedian(gap)) if np.isfinite(gap).any() else np.nan
    units = {"m": 1, "cm": 100, "mm": 1000}
    unit = [name for name, per in units.items() if _WIDTH_M[0] < width / per < _WIDTH_M[1]]
    found: dict[str, Any] = {"unit": unit[0]} if unit and unit[0] != "m" else {}
    if "preset" not in keys and any("right to left" in said for said in contradictions(log, False)):
        found["left_positive"] = True
    return found


def _said(log: LineLog) -> dict[str, Any]:
    """What is to be said of the lines of a recording."""
    step, frames = np.diff(log.time_s), np.diff(log.frame_id)
    gap = int(np.argmax(step)) if len(step) else 0
    valid = log.offset_m[log.is_valid]
    mirrored = contradictions(replace(log, offset_m=-log.offset_m), False)
    is_told = any("right to left" in said for said in mirrored)
    return {
        "frames": len(log),
        "frame_rate": rate_of(log.frame_id, log.time_s),
        "gaps": int((frames > 1).sum()),
        "longest_gap_s": float(step[gap]) if (frames > 1).any() else None,
        "longest_gap_after_frame": int(log.frame_id[gap]) if (frames > 1).any() else None,
        "lines_per_frame": float(log.is_valid.sum() / max(1, len(log))),
        "offset_m": [float(valid.min()), float(valid.max())] if len(valid) else None,
        "sign": "their order goes from left to right" if is_told else "these data do not tell",
    }
