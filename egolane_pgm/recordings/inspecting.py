"""Looks at a recording that nobody described: what is in it, which fields may be lines, and the
mapping that would read them. It only proposes; what is run is what the user then says."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
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
from egolane_pgm.recordings.fields import Table, arrow_column
from egolane_pgm.recordings.mapping import (
    LinesGiven,
    columns_of,
    contradictions,
    lines_of,
    lines_of_table,
    mapping_keys,
    mapping_of,
    presets,
    seconds,
)
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.table import TABLES, read_columns, separator_of
from egolane_pgm.types import InputError, LineLog

#: Messages of a topic that are looked at.
LOOKED_AT = 2000

#: Lanes are this wide, metres; the unit is the one in which they are.
_WIDTH_M = (2.2, 5.0)

#: Steps between frames, seconds, by which the unit of time stamps is found.
_STEP_S = (0.004, 3.0)

#: Names by which fields are known; of offsets the likeliest first.
_OFFSET = ("offset", "lateral", r"(^|_)c0$", "position", "dist", r"(^|_)y0?$")
_TIME = r"time|stamp|^t$|sec"
_FRAME = r"^(frame|seq|image|cycle)"
_VALID = r"valid|conf|prob|qual|score"
_CONTINUOUS = r"solid|contin|type|kind|style|mark|class"

_Tables = dict[str, tuple[str, int | None, Table]]
_Read = Callable[[LinesMapping], LineLog]


@dataclass(frozen=True)
class _Leaf:
    """A field that holds values: the span of numbers, or some of the texts."""

    path: str
    type: str
    low: float | None = None
    high: float | None = None
    texts: tuple[str, ...] = ()

    def has(self, pattern: str) -> bool:
        """Whether the last part of the path, in small letters, has a pattern."""
        name = re.sub(r"\[.*?\]", "", self.path.rpartition(".")[2])
        return bool(re.search(pattern, name.lower()))


def look_into(
    path: Path, given: LinesGiven | None = None, definitions: str | Path | None = None
) -> dict[str, Any]:
    """What is in a recording.

    - given: the mapping that is looked through, in place of a guess.
    - definitions: of a log's messages, see `recordings.containers`.

    Returns the file, its topics with their fields, and, where lines were found, their mapping
    (`lines`), frames, rate, gaps, span and what their signs tell; else the `problem`.
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
            return found | {"lines": guess, **_said(read(mapping_of(guess, str(path))))}
    return found


def _tables(
    path: Path, keys: LinesMapping, definitions: str | Path | None
) -> tuple[_Tables, _Read, _Read]:
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
    found = separator_of(path)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        comma = any(re.search(r"\d,\d", row) for row in islice(file, 1, 20))
    said = {"separator": found.replace("\t", "\\t"), **({"decimal": ","} if comma else {})}
    return {} if found == "," else said


# --- guesses -------------------------------------------------------------------------------------


def _guesses(tables: _Tables, leaves: Mapping[str, list[_Leaf]]) -> Iterator[dict[str, Any]]:
    """Mappings that may read the lines, the likeliest first."""
    yield {}
    for name, keys in presets().items():
        for topic, (_, _, table) in tables.items():
            where = {"topic": topic} if len(tables) > 1 and "topic" not in keys else {}
            is_timed = topic or {"time", "frame_id"} & {*keys}
            yield {"preset": name, **where, **({} if is_timed else _frames(leaves[topic], table))}
    for topic, each in _alike(tables).items():
        first = topic.replace("{}", each[0])
        for guess in _by_names(leaves[first], tables[first][2]):
            yield {"topic": topic, "each": each, **guess}
    for topic, (_, _, table) in tables.items():
        for guess in _by_names(leaves[topic], table):
            yield {**({"topic": topic} if len(tables) > 1 else {}), **guess}


def _alike(topics: _Tables) -> dict[str, list[str]]:
    """Topics that differ in a number or a side, as `{}`, and what stands there."""
    found: dict[str, list[str]] = {}
    for topic in topics:
        for match in re.finditer(r"\d+|left|right", topic, re.I):
            name = f"{topic[: match.start()]}{{}}{topic[match.end() :]}"
            found.setdefault(name, []).append(match[0])
    return {k: sorted(each, key=lambda e: (len(e), e)) for k, each in found.items() if each[1:]}


def _frames(leaves: list[_Leaf], table: Table) -> dict[str, str]:
    """Which fields may be frame id and time, where none have our own names."""
    at_root = [leaf for leaf in leaves if "[]" not in leaf.path]
    found: dict[str, str] = {}
    if table.own("frame_id") is None:
        for leaf in [x for x in at_root if x.has(_FRAME) and x.low is not None][:1]:
            found["frame_id"] = leaf.path
    for leaf in at_root if table.own("time_s") is None else []:
        is_date = leaf.type.startswith("timestamp")
        if is_date or (leaf.has(_TIME) and leaf.low is not None):
            section = leaf.path.rpartition(".")[0]
            is_stamp = bool(section) and leaf.has("^(secs?|seconds)$")
            said = _time(table, section if is_stamp else leaf.path)
            if said:
                return found | said
    return found


def _time(table: Table, path: str) -> dict[str, str]:
    """A field as time, with the unit by which its steps are those of a camera."""
    for unit in ("s", "ms", "us", "ns"):
        with contextlib.suppress(InputError):
            step = np.diff(seconds(table, path, unit))
            later = step[step > 0]
            if len(later) and (step >= 0).all() and _STEP_S[0] < np.median(later) < _STEP_S[1]:
                return {"time": path, **({} if unit == "s" else {"time_unit": unit})}
    return {}


def _by_names(leaves: list[_Leaf], table: Table) -> Iterator[dict[str, Any]]:
    """Mappings of a table by the names and values of its fields."""
    frames = _frames(leaves, table)
    for leaf in (leaf for pattern in _OFFSET for leaf in leaves if leaf.has(pattern)):
        if leaf.low is None or leaf.high is None or not leaf.low < leaf.high <= 1e5:
            continue
        side = re.search("left|right", leaf.path, re.I)
        word, place = side[0] if side else "", leaf.path.rpartition(".")[0]
        beside = [o for o in leaves if o.path.rpartition(".")[0] == place and word in o.path]
        keys = {"offset": leaf.path, **_flags(beside)}
        if word:
            keys = {key: said.replace(word, "{}") for key, said in keys.items()}
            keys["each"] = ["left", "right"] if word.islower() else ["Left", "Right"]
        yield {**frames, **keys}


def _flags(beside: list[_Leaf]) -> dict[str, Any]:
    """Conditions on the fields beside an offset."""
    found: dict[str, Any] = {}
    for leaf in beside:
        solid = [text for text in leaf.texts if re.search("solid|double|edge|curb", text, re.I)]
        if leaf.has(_VALID) and leaf.high is not None:
            found.setdefault("is_valid", f"{leaf.path} {'> 0.5' if leaf.high <= 1 else '>= 2'}")
        elif leaf.has(_VALID) and leaf.type == "bool":
            found.setdefault("is_valid", leaf.path)
        elif leaf.has(_CONTINUOUS) and leaf.type == "bool":
            found["is_continuous"] = leaf.path
        elif leaf.has(_CONTINUOUS) and solid:
            found["is_continuous"] = f"{leaf.path} in [{', '.join(solid)}]"
    return found


def _unit_and_sign(log: LineLog, keys: Mapping[str, Any]) -> dict[str, Any]:
    """The unit in which the lanes are as wide as lanes are, and the sign by which lines that have
    an order go from left to right."""
    offset = np.sort(np.where(log.is_valid, log.offset_m, np.nan), axis=1)
    gap = np.diff(offset, axis=1)
    width = np.median(gap[~np.isnan(gap)]) if np.isfinite(gap).any() else np.nan
    found: dict[str, Any] = {}
    for unit, per in (("cm", 100), ("mm", 1000)):
        if _WIDTH_M[0] < width / per < _WIDTH_M[1]:
            found["unit"] = unit
    if "preset" not in keys and "backwards" in contradictions(log):
        found["left_positive"] = True
    return found


def _said(log: LineLog) -> dict[str, Any]:
    """What is to be said of the lines of a recording."""
    step, is_gap = np.diff(log.time_s), np.diff(log.frame_id) > 1
    gap = int(np.argmax(step)) if is_gap.any() else None
    valid = log.offset_m[log.is_valid]
    is_told = "backwards" in contradictions(replace(log, offset_m=-log.offset_m))
    return {
        "frames": len(log),
        "frame_rate": rate_of(log.frame_id, log.time_s),
        "gaps": int(is_gap.sum()),
        "longest_gap_s": None if gap is None else float(step[gap]),
        "longest_gap_after_frame": None if gap is None else int(log.frame_id[gap]),
        "lines_per_frame": float(log.is_valid.sum() / max(1, len(log))),
        "offset_m": [float(valid.min()), float(valid.max())] if len(valid) else None,
        "sign": "the order of the lines agrees"
        if is_told
        else "the data do not say whether rightly",
    }
