"""Where the lines stand in what was recorded: one mapping for tables and for messages.

A `LinesMapping` (`recording: lines:` of a YAML) says which field is what; `fields` says how one is
named. What stands beside an offset is looked for there first: with `offset: lanes[].c0`,
`confidence` is `lanes[].confidence`. What a mapping leaves out has our own name, `COLUMNS`, where
it is there.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from egolane_pgm.experiment import LinesMapping, validated
from egolane_pgm.recordings.fields import (
    FLAGS,
    Cells,
    Table,
    arrow_column,
    check_whole,
    place,
    typed,
)
from egolane_pgm.tools.files import read_text, read_yaml
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import (
    NOTE,
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LineLog,
    near_word,
    suggestion,
)

#: What each column of a table means; messages have the same names.
COLUMNS = {
    "frame_id": "number of the frame; increases, the rows of a frame stand together",
    "time_s": "when the frame was seen, seconds; left out, frame id over frame rate",
    "line": "1, 2, ... within the frame, in the detector's order; left out, the order of the rows",
    "offset_m": "where the line passes the car, metres, negative to the left",
    "is_valid": "whether the detector trusts the line; left out, it does",
    "is_continuous": "whether the line is not dashed; left out, none is",
    "lri": "line reliability index: in how many of the last frames it was seen; left out, unknown",
    "is_missing": "marks frames that `missing_frames: predict` put in",
}

#: Frames per second of a table without times, where nothing else is said.
FRAME_RATE = 10.0

#: A line of a greater number is a mistake, and the padded arrays would fill the memory.
MAX_LINES = 1000

#: Columns that are the same in all rows of a frame.
_OF_FRAME = ("frame_id", "time_s", "is_missing")

#: What a column of a line says where it has no cell.
_BLANK = {"offset_m": np.nan, "is_valid": 1.0, "is_continuous": 0.0, "lri": np.nan}

#: An offset of a table with one row per frame.
_WIDE = re.compile(r"offset_\d+")

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}

#: The parts of a stamp as ROS 1, ROS 2 and protobuf call them.
SECONDS, NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos")

#: Signs are looked at in this many frames, at least and at most, and this share of them makes a
#: contradiction.
_ENOUGH, _LOOKED_AT, _MOST = 20, 2000, 0.9

#: A mapping as callers give it: keys and values, the name of a preset, a YAML file, `key=value`, or
#: a list of these.
LinesGiven = LinesMapping | Mapping[str, Any] | str | Sequence[str]


class Message(NamedTuple):
    """A message of a recording.

    - time_s: when it was made, seconds.
    - value: its fields: nested dicts and lists of numbers and texts, or arrays of NumPy.
    """

    time_s: float
    topic: str
    value: Mapping[str, Any]


# --- the mapping ---------------------------------------------------------------------------------


@cache
def presets() -> dict[str, dict[str, Any]]:
    """The mappings of known kinds of recordings, by name."""
    file = Path(__file__).parent / "presets.yaml"
    found: dict[str, dict[str, Any]] = parse_yaml(read_text(file), str(file))
    return found


def whole_mapping(mapping: LinesMapping | None, where: str) -> LinesMapping:
    """A mapping with the keys of its preset where it has none. Raises InputError for an unknown
    preset."""
    if mapping is None or mapping.preset is None:
        return mapping or LinesMapping()
    if mapping.preset not in presets():
        hint = suggestion(mapping.preset, presets())
        raise InputError(f"{where}: lines: unknown preset '{mapping.preset}'{hint}")
    keys = {**presets()[mapping.preset], **mapping.model_dump(exclude={"preset"})}
    return validated(LinesMapping, keys, where)


def mapping_keys(given: LinesGiven) -> dict[str, Any]:
    """The keys of `recording.lines` that a caller gives. Raises InputError for what is none.

    >>> from egolane_pgm.recordings.mapping import mapping_keys
    >>> mapping_keys(["mobileye", "left_positive=true"])
    {'preset': 'mobileye', 'left_positive': True}
    """
    if isinstance(given, LinesMapping):
        return given.model_dump()
    if isinstance(given, Mapping):
        return dict(given)
    keys: dict[str, Any] = {}
    for each in [given] if isinstance(given, str) else given:
        name, equals, value = each.partition("=")
        if each.endswith((".yaml", ".yml")):
            keys |= read_yaml(Path(each), "offset: lateral")
        elif equals:
            # To YAML `{}_c0` and a lone comma are something else.
            is_text = value.startswith("{}") or len(value) == 1
            name = name.strip()
            keys[name] = value if is_text else parse_yaml(value, f"lines: {name}")
        elif each in presets():
            keys["preset"] = each
        else:
            hint = suggestion(each, presets())
            raise InputError(f"lines: {each!r} is no preset, no YAML file and no key=value{hint}")
    return keys


def mapping_of(given: LinesGiven, where: str) -> LinesMapping:
    """What a caller gives as a mapping. Raises InputError for keys that do not fit."""
    return validated(LinesMapping, mapping_keys(given), f"{where}: lines")


def topics_of(mapping: LinesMapping) -> tuple[str, ...]:
    """The topics that a mapping with its preset's keys names; none: the only one."""
    topic = "" if mapping.topic is None else str(mapping.topic)
    found = [topic.replace("{}", each) for each in mapping.each or ("",)] if topic else []
    found += [str(keys["topic"]) for keys in mapping.also if "topic" in keys]
    return tuple(dict.fromkeys(found))


class _Part(NamedTuple):
    """Lines that are mapped alike. name, slot: what takes the place of `{}`, and the number of that
    line, from 0."""

    keys: LinesMapping
    name: str = ""
    slot: int | None = None


def _parts(mapping: LinesMapping, names: Iterable[str], where: str) -> list[_Part]:
    """What `each` and `also` stand for. names: of the columns."""
    own = mapping.model_dump(exclude={"each", "also", "preset"})
    offset = mapping.offset if isinstance(mapping.offset, str) else (mapping.offset or ("",))[0]
    found = [_Part(LinesMapping(**own))]
    if "{}" in f"{offset}{mapping.topic or ''}":
        pattern = re.compile(re.escape(offset).replace(r"\{\}", r"(\d+)"))
        each = mapping.each or [m[1] for name in names if (m := pattern.fullmatch(name))]
        if not each:
            raise InputError(f"{where}: lines: each: is missing; say what {{}} stands for")
        is_number = all(name.isdigit() for name in each)
        first = min(1, *map(int, each), 1) if is_number else 0
        text = found.pop().keys.model_dump_json()
        for k, name in enumerate(each):
            keys = LinesMapping.model_validate_json(text.replace("{}", json.dumps(name)[1:-1]))
            found.append(_Part(keys, name, int(name) - first if is_number else k))
    for others in mapping.also:
        part = validated(LinesMapping, {**own, **others}, f"{where}: lines: also")
        found += _parts(part, names, where)
    return found


def _with_offset(mapping: LinesMapping, table: Table) -> LinesMapping:
    """The mapping with our own names for the offsets, where it names none."""
    if mapping.offset is not None:
        return mapping
    own = table.own("offset_m")
    if own is None and any(map(_WIDE.fullmatch, table.columns)):
        own = "offset_{}"
    elif own is None and table.has("lines[].offset_m"):
        own = "lines[].offset_m"
    if own is None:
        there = ", ".join(table.columns) or "none"
        raise InputError(
            f"{table.path}: no column offset_m{near_word('offset_m', table.columns)}; the table"
            f" has {there}; it needs a row per line (frame_id, line, offset_m) or per frame"
            " (frame_id, offset_1, offset_2, ...); `lines: {offset: NAME}` says what yours is"
            " called, and `egolane inspect` what to write"
        )
    return mapping.model_copy(update={"offset": own})


# --- the lines of a part -------------------------------------------------------------------------


def _beside(path: str, is_points: bool) -> str:
    """The list or section in which a field stands, of points that of the line."""
    if is_points and "[]" in path:
        path = path[: path.rindex("[]")]
    return f"{path.rpartition('.')[0]}." if "." in path else ""


def _rows_of(table: Table, part: _Part, base: int | None) -> tuple[Cells, IntArray]:
    """The N lines of a part, by our names, and the row of the table of each.

    - base: the number of the first line of a row, from 0; None: as the rows come.
    """
    keys = part.keys
    paths = (keys.offset,) if isinstance(keys.offset, str) else (keys.offset or ())
    at_m = keys.at_m or 0.0
    section, beside = _beside(paths[0], False), _beside(paths[0], keys.along is not None)
    offset, up = table.numbers("offset_m", paths[0], key="offset")
    for power, path in enumerate(paths[1:], start=1):
        values, of = table.numbers("offset_m", path, section, key="offset")
        offset = offset + table.aligned("offset", values, of, up) * at_m**power
    if keys.along is not None:
        if not up:
            raise InputError(f"{table.path}: lines: along: {paths[0]} is no list of points")
        along = table.aligned("along", *table.numbers("along", keys.along, section), up)
        n_lines = len(up[-2]) if len(up) > 1 else table.n_rows
        offset, up = _at(at_m, along, offset, up[-1], n_lines), up[:-1]
    offset, row = offset / _PER_METRE[keys.unit or "m"], table.rows(up)
    cells: Cells = {"offset_m": -offset if keys.left_positive else offset}
    for name in ("is_valid", "is_continuous", "lri", "line"):
        said = getattr(keys, name)
        if said is None:
            # In a table with one row per frame it is is_valid_1, or valid_1.
            of_line = (f"{each}_{part.name}" for each in (name, name.removeprefix("is_")))
            ours = [table.own(name, beside), *map(table.own, of_line)]
            said = next(filter(None, ours), None)
        if isinstance(said, bool):
            cells[name] = np.full(len(offset), float(said))
        elif said is not None:
            find = table.is_so if name in FLAGS else table.numbers
            cells[name] = table.aligned(name, *find(name, said, beside), up)
    if "line" in cells:
        check_whole(table.path, cells, "line", row)
        cells["line"] = cells["line"] + (np.nanmin(cells["line"], initial=1) == 0)
    elif base is not None or up:
        number = np.arange(len(row)) - np.searchsorted(row, row) + (base or 0) + 1
        cells["line"] = number.astype(np.float64)
    cells.setdefault("is_valid", np.where(np.isnan(offset), 0.0, 1.0))
    if part.slot is not None and not up:
        # A line that is said to be valid is there, and without an offset it is a mistake.
        there = ~np.isnan(offset) | (cells["is_valid"] == 1)
        cells, row = {name: values[there] for name, values in cells.items()}, row[there]
    return cells, row


def _at(at_m: float, x: FloatArray, y: FloatArray, line: IntArray, n_lines: int) -> FloatArray:
    """Where lines of points (N,) are `at_m` ahead, (n_lines,): between two points on the straight
    line, before the first and behind the last where these are."""
    found = np.full(n_lines, np.nan)
    is_there = ~(np.isnan(x) | np.isnan(y))
    x, y, line = x[is_there], y[is_there], line[is_there]
    ends = np.searchsorted(line, np.arange(n_lines + 1))
    for k in np.unique(line):
        points = slice(ends[k], ends[k + 1])
        order = np.argsort(x[points], kind="stable")
        found[k] = np.interp(at_m, x[points][order], y[points][order])
    return found


# --- frames --------------------------------------------------------------------------------------


def _frames_of(table: Table, mapping: LinesMapping, first: int = 0) -> Cells:
    """Of each row of a table (T,) the frame id and, where they are known, time and is_missing.

    - first: the first frame id, where time gives them.
    """
    ids, time = mapping.frame_id or table.own("frame_id"), mapping.time or table.own("time_s")
    missing = table.own("is_missing")
    cells: Cells = {}
    if time is not None:
        cells["time_s"] = seconds(table, time, mapping.time_unit or "s")
    if ids is not None:
        cells["frame_id"], _ = table.numbers("frame_id", ids)
        check_whole(table.path, cells, "frame_id", np.arange(table.n_rows))
    elif time is not None:
        cells["frame_id"] = first + _ids_of(table.path, cells["time_s"])
    else:
        raise InputError(
            f"{table.path}: no column frame_id{near_word('frame_id', table.columns)}, nor time_s;"
            f" the table has {', '.join(table.columns)}; `lines: {{frame_id: NAME}}` or `{{time:"
            " NAME, time_unit: s}` says what yours is called"
        )
    if missing is not None:
        cells["is_missing"], _ = table.numbers("is_missing", missing)
    return cells


def seconds(table: Table, path: str, unit: str) -> FloatArray:
    """A field as times in seconds (T,): numbers of a unit, dates, or stamps."""
    _, values, _ = table.values("time", path)
    per = _PER_SECOND[unit]
    if pa.types.is_struct(values.type):
        known = [f.name for f in values.type]
        parts = [name for names in (SECONDS, NANOSECONDS) for name in names if name in known]
        if len(parts) != 2:
            raise InputError(f"{table.path}: lines: time: {path} has {', '.join(known)}")
        whole, rest = (typed(table.path, name, pc.struct_field(values, name)) for name in parts)
        return whole + rest / 1e9
    if pa.types.is_timestamp(values.type):
        values, per = values.cast(pa.timestamp("ns", values.type.tz)).cast(pa.int64()), 10**9
    if pa.types.is_integer(values.type) and not values.null_count:
        # Nanoseconds since 1970 have more digits than a float.
        ticks = values.to_numpy(zero_copy_only=False)
        time_s: FloatArray = ticks // per + ticks % per / per
    else:
        time_s = typed(table.path, "time_s", values, path) / per
    longest = float(np.nanmax(np.abs(time_s), initial=0))
    if longest > 1e11:
        likely = next(name for name, n in _PER_SECOND.items() if longest * per / n < 1e11)
        raise InputError(
            f"{table.path}: {path} is {longest * per:.4g}, which is no time in {unit}: `lines:"
            f" {{time: {path}, time_unit: {likely}}}`"
        )
    return time_s


def _ids_of(path: Path, time_s: FloatArray) -> FloatArray:
    """Frame ids by the time stamps (T,) of rows; they begin with 0. A step of the median counts as
    one frame, and a longer one as the whole multiple that is nearest to it: gaps stay gaps."""
    step = np.diff(time_s, prepend=-np.inf)
    for bad, said in ((np.isnan(time_s), "is empty"), (step < 0, "goes back; sort by time")):
        if bad.any():
            raise InputError(f"{place(path, int(np.argmax(bad)))}: time {said}")
    step = step[1:]
    later = step[step > 0]
    if not len(later):
        return np.zeros(len(time_s))
    usual = float(np.median(later))
    share = float(np.mean(np.abs(later / usual - np.rint(later / usual)) > 0.25))
    if share > 0.05:
        warnings.warn(
            f"{NOTE}{path}: {share:.0%} of the steps between its time stamps are no multiple of"
            f" their median, {usual:.4g} s, by which frames are counted",
            UserWarning,
            stacklevel=2,
        )
    frames = np.where(step > 0, np.maximum(1, np.rint(step / usual)), 0)
    return np.concatenate([[0.0], np.cumsum(frames)])


# --- tables and messages -------------------------------------------------------------------------


def lines_of_table(
    columns: Mapping[str, Any],
    mapping: LinesMapping | None,
    path: Path,
    frame_rate: float = FRAME_RATE,
    *,
    first: int = 0,
) -> LineLog:
    """The lines of a table, T frames of at most L lines.

    - columns: of pyarrow or pandas, by name; nested ones have fields.
    - path: the file, for messages. frame_rate: frames per second of a table without times.
    - first: the first frame id, where time gives them.

    Raises InputError for a field that is not there, a cell that does not fit (with its place),
    frames that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    if not len(next(iter(columns.values()), ())):
        raise InputError(f"{path}: the table has no rows")
    whole = whole_mapping(mapping, str(path))
    is_own = whole.offset is None
    if is_own:
        shorter = {re.sub(r"^offset_m_(?=\d+$)", "offset_", k): v for k, v in columns.items()}
        if len(shorter) < len(columns):
            raise InputError(f"{path}: has a line as offset_N and as offset_m_N; leave one out")
        columns = shorter
    tables = {topic: _inside(columns, topic, path) for topic in topics_of(whole) or ("",)}
    table = next(iter(tables.values()))
    whole = _with_offset(whole, table)
    log = _joined(tables, whole, path, frame_rate, first)
    unused = [name for name in table.columns if name and name not in table.used]
    if is_own and unused:
        known = {*(COLUMNS if whole.offset == "offset_m" else _OF_FRAME)} - table.used
        others = ", ".join(name + near_word(name, known) for name in unused)
        warnings.warn(f"{path}: ignored column(s) {others}", UserWarning, stacklevel=3)
    return log


def _inside(columns: Mapping[str, Any], topic: str, path: Path) -> Table:
    """A table, or its rows that have messages of a topic, where it has a column of that name."""
    n_rows = len(next(iter(columns.values())))
    values = arrow_column(columns[topic]) if topic in columns else None
    if values is None or not pa.types.is_struct(values.type):
        return Table(columns, n_rows, path)
    there = pc.is_valid(values)
    others = {name: arrow_column(each).filter(there) for name, each in columns.items()}
    values = others.pop(topic)
    fields = {f.name: pc.struct_field(values, f.name) for f in values.type}
    return Table({**others, **fields}, len(values), path)


def lines_of(
    messages: Iterable[Message],
    mapping: LinesMapping | None,
    where: str,
    *,
    frame_rate: float = FRAME_RATE,
) -> LineLog:
    """The lines of messages, T frames of at most L lines.

    - messages: in the order in which they were recorded; those on other topics are left out.
    - mapping: which fields are what; None for our own names, as in `egolane online`.
    - where: names the file in what is said of it.
    - frame_rate: frames per second where the messages have frame ids but no times.

    Raises InputError as `lines_of_table`, and for a topic that is not there.

    >>> from egolane_pgm.experiment import LinesMapping
    >>> from egolane_pgm.recordings.mapping import Message, lines_of
    >>> left_of_it = {"lanes": [{"c0": 1.8, "confidence": 0.9}, {"c0": -1.7, "confidence": 0.2}]}
    >>> mapping = LinesMapping(offset="lanes[].c0", is_valid="confidence > 0.5", left_positive=True)
    >>> log = lines_of([Message(12.0, "/lanes", left_of_it)], mapping, "drive.mcap")
    >>> log.offset_m.tolist(), log.is_valid.tolist()
    ([[-1.8, 1.7]], [[True, False]])
    """
    whole, path = whole_mapping(mapping, where), Path(where)
    by_topic: dict[str, list[Message]] = {}
    for message in messages:
        by_topic.setdefault(f"/{message.topic.strip('/')}", []).append(message)
    wanted = topics_of(whole) or tuple(by_topic)
    if not topics_of(whole) and len(by_topic) != 1:
        there = ", ".join(sorted(by_topic)) or "no messages"
        raise InputError(f"{where}: topic: is missing; there are {there}")
    tables = {}
    for topic in wanted:
        found = by_topic.get(f"/{topic.strip('/')}")
        if found is None:
            hint = suggestion(topic, by_topic)
            raise InputError(f"{where}: lines: topic: there is no topic {topic}{hint}")
        columns = columns_of([message.value for message in found], f"{where}: topic {topic}")
        columns.setdefault("time_s", pa.array([message.time_s for message in found]))
        tables[topic] = Table(columns, len(found), path)
    return _joined(tables, _with_offset(whole, next(iter(tables.values()))), path, frame_rate)


def columns_of(values: Sequence[Mapping[str, Any]], where: str) -> dict[str, Any]:
    """The fields of messages of one kind, of pyarrow. Raises InputError where they differ in
    type."""
    try:
        table = pa.Table.from_pylist([dict(value) for value in values])
    except (pa.ArrowException, TypeError, ValueError) as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(f"{where}: its messages are not alike ({said})") from None
    return dict(zip(table.column_names, table.columns, strict=True))


def _joined(
    tables: Mapping[str, Table],
    mapping: LinesMapping,
    path: Path,
    frame_rate: float,
    first: int = 0,
) -> LineLog:
    """The lines of all parts of a mapping.

    - tables: of each topic; the first of them is that of parts without one.
    """
    default = next(iter(tables))
    parts = _parts(mapping, tables[default].columns, str(path))
    named = [part.keys.topic or default for part in parts]
    topic_of = [topic if topic in tables else default for topic in named]
    frames = {topic: _frames_of(tables[topic], mapping, first) for topic in tables}
    of_frame, row_of = frames[default], {default: np.arange(tables[default].n_rows)}
    if len(frames) > 1:
        of_frame, row_of = _together(path, frames, by_id=mapping.frame_id is not None)
    found: list[tuple[Cells, IntArray]] = []
    base, width = 0, 0
    for part, topic in zip(parts, topic_of, strict=True):
        start = base if part.slot is None or mapping.also else part.slot
        is_only = len(parts) == 1 and part.slot is None
        cells, row = _rows_of(tables[topic], part, None if is_only else start)
        base = max(base, int(np.nanmax(cells.get("line", base), initial=0)))
        # Lines that `also` adds stand in no order with the others.
        width = base if part.slot is not None or not found else width
        found.append((cells, row_of[topic][row]))
    cells, row = _stacked(found, len(of_frame["frame_id"]))
    cells |= {name: values[row] for name, values in of_frame.items()}
    if "line" not in cells:
        # The rows of a frame are its lines; a single one without an offset says that it has none.
        frame = cells["frame_id"]
        before = np.searchsorted(frame, frame)
        is_alone = np.searchsorted(frame, frame, "right") - before == 1
        number = np.arange(1, len(row) + 1) - before
        cells["line"] = np.where(np.isnan(cells["offset_m"]) & is_alone, np.nan, number)
    log = _assemble(path, cells, row, frame_rate)
    for said in contradictions(log, bool(mapping.left_positive), width or None).values():
        warnings.warn(said, UserWarning, stacklevel=4)
    return log


def _stacked(found: Sequence[tuple[Cells, IntArray]], n_rows: int) -> tuple[Cells, IntArray]:
    """The lines of all parts in the order of their rows, of which one without lines has an empty
    one."""
    row = np.concatenate([row for _, row in found])
    absent = np.flatnonzero(np.bincount(row, minlength=n_rows) == 0)
    row = np.concatenate([row, absent])
    cells: Cells = {}
    for name in {name for of, _ in found for name in of}:
        lines = [of.get(name, np.full(len(at), _BLANK.get(name, np.nan))) for of, at in found]
        cells[name] = np.concatenate([*lines, np.full(len(absent), np.nan)])
    order = np.lexsort((cells.get("line", row), row))
    return {name: values[order] for name, values in cells.items()}, row[order]


def _together(
    path: Path, frames: Mapping[str, Cells], *, by_id: bool
) -> tuple[Cells, dict[str, IntArray]]:
    """The frames of several topics, and for each topic the frame of each message: by frame id, or
    those less than half a step apart."""
    name = "frame_id" if by_id else "time_s"
    if any(name not in cells for cells in frames.values()):
        raise InputError(f"{path}: lines: time: is missing; it says which messages go together")
    key = np.concatenate([cells[name] for cells in frames.values()])
    order = np.argsort(key, kind="stable")
    step = np.diff(next(iter(frames.values()))[name])
    apart = 0.0 if by_id or not len(step) else float(np.median(step)) / 2
    is_new = np.diff(key[order], prepend=-np.inf) > apart
    at = np.empty(len(key), dtype=np.int64)
    at[order] = np.cumsum(is_new) - 1
    ends = np.cumsum([0, *(len(cells[name]) for cells in frames.values())])
    row_of = {topic: at[a:b] for topic, a, b in zip(frames, ends, ends[1:], strict=False)}
    found = {name: key[order][is_new]}
    return found if by_id else {**found, "frame_id": _ids_of(path, found[name])}, row_of


# --- the log -------------------------------------------------------------------------------------


def _assemble(path: Path, cells: Cells, row: IntArray, frame_rate: float) -> LineLog:
    """The frames of a table that has a row for each line; row (N,): where each is in the file."""

    def refuse(bad: BoolArray, why: str) -> None:
        """Raise InputError for the first row that is bad; `{}` in `why` becomes its frame id."""
        if bad.any():
            k = int(np.argmax(bad))
            said = why.replace("{}", f"{cells['frame_id'][k]:.0f}")
            raise InputError(f"{place(path, int(row[k]))}: {said}")

    for name in (name for name in _OF_FRAME if name in cells):
        refuse(np.isnan(cells[name]), f"{name} is empty")
    frame, offset = cells["frame_id"].astype(np.int64), cells["offset_m"]
    has_line = ~np.isnan(cells["line"])
    line = np.where(has_line, cells["line"], 0).astype(np.int64) - 1
    step = np.diff(frame, prepend=frame[0])
    refuse(step < 0, "frame {} comes after a later one; sort the table by frame_id")
    refuse(has_line & ((line < 0) | (line >= MAX_LINES)), f"line is not in 1..{MAX_LINES}")
    starts = step != 0
    starts[0] = True
    if "time_s" in cells:
        is_later = np.diff(cells["time_s"], prepend=-np.inf) > 0
        refuse(starts & ~is_later, "time_s of frame {} is not later than that before")
    at = np.cumsum(starts) - 1
    is_lone_frame = (np.bincount(at)[at] == 1) & np.isnan(offset)
    refuse(
        ~has_line & ~is_lone_frame,
        "frame {} has a row with an empty line, but with an offset or next to other rows",
    )
    first = np.unique(np.stack([at, cells["line"]]), axis=1, return_index=True)[1]
    refuse(has_line & ~np.isin(np.arange(len(at)), first), "frame {} has this line twice")
    for name in (name for name in ("is_valid", "is_continuous") if name in cells):
        cure = f"; `lines: {{{name}: {name} == 1}}` takes it as false"
        refuse(np.isnan(cells[name]) & has_line, f"frame {{}} has a line with empty {name}{cure}")
    zeros = np.zeros(len(frame))
    log = LineLog.from_rows(
        frame[starts],
        frame_rate,
        at[has_line],
        offset[has_line],
        cells["is_valid"][has_line] == 1,
        cells.get("is_continuous", zeros)[has_line] == 1,
        cells.get("lri", zeros + np.nan)[has_line],
        row_line=line[has_line],
        is_missing=cells.get("is_missing", zeros)[starts] == 1,
        source=str(path),
    )
    return replace(log, time_s=cells["time_s"][starts]) if "time_s" in cells else log


# --- signs ---------------------------------------------------------------------------------------


def contradictions(
    log: LineLog, is_left_positive: bool = False, width: int | None = None
) -> dict[str, str]:
    """The ways in which the signs of the offsets contradict themselves, `one-sided` or
    `backwards`, each with what may cure it; they are used all the same.

    - width: how many lines have numbers from left to right; None for all.
    """
    several = np.flatnonzero(log.is_valid.sum(axis=1) > 1)
    if len(several) < _ENOUGH:
        return {}
    several = several[:: 1 + len(several) // _LOOKED_AT]
    offset = np.where(log.is_valid, log.offset_m, np.nan)[several]
    said = {}
    one_sided = np.mean((np.nanmin(offset, axis=1) > 0) | (np.nanmax(offset, axis=1) < 0))
    if one_sided > _MOST:
        said["one-sided"] = (
            f"{log.source}: in {one_sided:.0%} of the frames all lines are on one side of the car;"
            " are the offsets distances without a sign? `lines: also` takes the lines of each side"
            " with their own left_positive"
        )
    offset = offset[:, :width]
    order = np.argsort(np.isnan(offset), axis=1, kind="stable")
    step = np.diff(np.take_along_axis(offset, order, axis=1), axis=1)
    backwards = np.mean((step < 0).any(axis=1) & ~(step >= 0).any(axis=1))
    if backwards > _MOST:
        side, turned = ("right", "false") if is_left_positive else ("left", "true")
        said["backwards"] = (
            f"{log.source}: in {backwards:.0%} of the frames the lines go from right to left; are"
            f" their offsets positive to the {side}? then `lines: {{left_positive: {turned}}}`"
        )
    return said
