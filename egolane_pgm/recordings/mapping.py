"""Where the lines stand in what was recorded: one mapping for tables and for messages.

A table's rows and a topic's messages are the same here: columns of pyarrow, nested ones where the
fields are. A `LinesMapping` (`recording: lines:` of a YAML) says which field is what. A field is
named by its path: `header.seq`, `lanes[].c0` (each of a list), `y[0]` (its first). What stands
beside an offset is looked for beside it first: with `offset: lanes[].c0`, `confidence` is
`lanes[].confidence`. What a mapping leaves out has our own name, `COLUMNS`, where it is there.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from egolane_pgm.experiment import LinesMapping, validated
from egolane_pgm.recordings.cells import FLAGS, Cells, arrow_column, check_whole, place, typed
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.tools.files import read_text
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

#: The columns of a table with one row per frame.
_WIDE = re.compile(r"offset(?:_m)?_(\d+)")

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}

#: The parts of a stamp: of ROS 2, of ROS 1, of protobuf.
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos"))

#: A step of the time stamps that is no multiple of the median by this share of it is irregular.
_IRREGULAR = 0.25

#: Frames from which on signs are looked at, and the share of frames that makes a contradiction.
_ENOUGH, _MOST = 20, 0.9


class Message(NamedTuple):
    """A message of a recording.

    - time_s: when it was recorded, seconds.
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
    keys = {key: getattr(mapping, key) for key in mapping.model_fields_set}
    return validated(LinesMapping, {**presets()[mapping.preset], **keys}, where)


def mapping_keys(given: str | Mapping[str, Any] | Sequence[str]) -> dict[str, Any]:
    """The keys of `recording.lines` that a caller gives: keys and values, the name of a preset, a
    YAML file, `key=value`, or a list of these. Raises InputError for anything else."""
    if isinstance(given, LinesMapping):
        return given.model_dump(exclude_unset=True)
    if isinstance(given, Mapping):
        return dict(given)
    keys: dict[str, Any] = {}
    for each in [given] if isinstance(given, str) else given:
        name, equals, value = each.partition("=")
        if each.endswith((".yaml", ".yml")):
            found = parse_yaml(read_text(Path(each)), each)
            if not isinstance(found, dict):
                raise InputError(f"{each}: needs keys and values, e.g. offset: lateral")
            keys |= found
        elif equals:
            keys[name.strip()] = parse_yaml(value, f"lines: {name.strip()}")
        elif each in presets():
            keys["preset"] = each
        else:
            hint = suggestion(each, presets())
            raise InputError(
                f"lines: {each!r} is neither a preset, a YAML file nor key=value{hint}"
            )
    return keys


@dataclass(frozen=True)
class _Part:
    """Lines that are mapped alike. slot: the number of the first, from 0; None: as they come."""

    keys: LinesMapping
    name: str = ""
    slot: int | None = None


def _parts(mapping: LinesMapping, names: Iterable[str], where: str) -> list[_Part]:
    """What `each` and `also` stand for. names: of the columns, where there is one table."""
    own = mapping.model_copy(update={"also": (), "each": ()})
    found: list[_Part] = []
    offset = mapping.offset if isinstance(mapping.offset, str) else (mapping.offset or ("",))[0]
    if "{}" in f"{offset}{mapping.topic or ''}":
        each = mapping.each
        if not each:
            pattern = re.compile(re.escape(offset).replace(r"\{\}", r"(\d+)"))
            each = tuple(match[1] for name in names if (match := pattern.fullmatch(name)))
        if not each:
            raise InputError(f"{where}: lines: each: is missing; say what {{}} stands for")
        first = min(int(k) if k.isdigit() else 0 for k in each)
        for k, name in enumerate(each):
            slot = int(name) - (first > 0) if all(n.isdigit() for n in each) else k
            found.append(_Part(_filled(own, name), name, slot))
    else:
        found.append(_Part(own))
    for keys in mapping.also:
        given = {key: getattr(own, key) for key in own.model_fields_set if key != "preset"}
        part = validated(LinesMapping, {**given, **keys}, f"{where}: lines: also")
        found += _parts(part, names, where)
    return found


def _filled(keys: LinesMapping, name: str) -> LinesMapping:
    """The keys with a name in place of each `{}`."""

    def fill(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(fill, value))
        return value.replace("{}", name) if isinstance(value, str) else value

    given = {key: fill(getattr(keys, key)) for key in keys.model_fields_set}
    return keys.model_copy(update=given)


# --- fields --------------------------------------------------------------------------------------


class _NoField(LookupError):
    """A path that leads nowhere: `part` is not among `known`."""

    def __init__(self, part: str, known: Sequence[str]) -> None:
        super().__init__(part)
        self.part, self.known = part, known


@dataclass(frozen=True)
class _Field:
    """What a path leads to: N values.

    - values (N,): of pyarrow.
    - up: for each `[]` of the path, the outer first, the list that each element is of; the last is
      (N,).
    """

    values: Any
    up: tuple[IntArray, ...] = ()

    def rows(self, n_rows: int) -> IntArray:
        """The row of the table of each value, (N,)."""
        rows = np.arange(n_rows)
        for up in self.up:
            rows = rows[up]
        return rows


#: The name of a column or field, an element of a list, or each.
_STEP = re.compile(r"\.([^.\[\]]+)|\[(-?\d*)\]")


def _follow(columns: Mapping[str, Any], path: str) -> _Field:
    """The values of a field. Raises _NoField where the path leads nowhere."""
    # A table's columns may have dots and brackets in their names.
    ends = [len(path), *(m.start() for m in reversed(list(re.finditer(r"[.\[]", path))))]
    end = next((end for end in ends if path[:end] in columns), None)
    if end is None:
        raise _NoField(path[: ends[-1]], [*columns])
    values, up = arrow_column(columns[path[:end]]), ()
    while end < len(path):
        step = _STEP.match(path, end)
        if step is None:
            raise _NoField(path[end:], [])
        name, index = step[1], step[2]
        if pa.types.is_null(values.type):
            # Of a list that is always empty nobody knows what is in it.
            if index == "":
                values, up = values[:0], (*up, np.zeros(0, dtype=np.int64))
        elif name is not None:
            known = [f.name for f in values.type] if pa.types.is_struct(values.type) else []
            if name not in known:
                raise _NoField(name, known)
            values = pc.struct_field(values, name)
        else:
            values, up = _listed(values, up, index)
        end = step.end()
    return _Field(values, up)


def _listed(values: Any, up: tuple[IntArray, ...], index: str) -> tuple[Any, tuple[IntArray, ...]]:
    """Each element of lists, or the one of an index; null where a list is too short."""
    if pa.types.is_fixed_size_list(values.type):
        values = values.cast(pa.list_(values.type.value_type))
    if not (pa.types.is_list(values.type) or pa.types.is_large_list(values.type)):
        raise _NoField(f"[{index}]", [])
    parent = pc.list_parent_indices(values).to_numpy(zero_copy_only=False).astype(np.int64)
    flat = pc.list_flatten(values)
    if index == "":
        return flat, (*up, parent)
    length = pc.list_value_length(values).fill_null(0).to_numpy(zero_copy_only=False)
    at = int(index) if int(index) >= 0 else length + int(index)
    is_there = (at >= 0) & (at < length)
    found = np.where(is_there, np.cumsum(length) - length + at, 0)
    return flat.take(pa.array(found, mask=~is_there)), up


@dataclass(frozen=True)
class _Table:
    """The columns of a table, or the fields of the messages of a topic.

    - columns: of pyarrow or pandas, T rows each, by name.
    - path: names the file in messages.
    """

    columns: Mapping[str, Any]
    n_rows: int
    path: Path

    def field(self, key: str, path: str, beside: str = "") -> tuple[str, _Field]:
        """A field and its whole path. beside: the list or section in which it is looked for first,
        `lanes[].`. Raises InputError, which names the key, where it is not there."""
        try:
            return beside + path, _follow(self.columns, beside + path)
        except _NoField as error:
            wrong = error
        if beside:
            try:
                return path, _follow(self.columns, path)
            except _NoField as error:
                wrong = error if error.part != path else wrong
        hint = near_word(wrong.part, wrong.known)
        there = f"; there are {', '.join(wrong.known)}" if wrong.known else ""
        what = f"there is no '{wrong.part}'" + (f" in {path}" if wrong.part != path else "")
        raise InputError(f"{self.path}: lines: {key}: {what}{hint}{there}")

    def has(self, path: str) -> bool:
        """Whether there is such a field."""
        try:
            _follow(self.columns, path)
        except _NoField:
            return False
        return True

    def own(self, name: str, beside: str = "") -> str | None:
        """The path of a field that has our name, in capitals or not; None where none has."""
        if self.has(beside + name):
            return beside + name
        same = [each for each in self.columns if each.casefold() == name]
        return same[0] if same and not beside else None


def _numbers(table: _Table, name: str, path: str, found: _Field) -> FloatArray:
    """The values of a field as numbers; name: ours, by which they are checked."""
    return typed(table.path, name, found.values, path, found.rows(table.n_rows))


_CONDITION = re.compile(r"(.+?)\s*(>=|<=|==|!=|>|<|\s(?:not )?in\s)\s*(.+)")
_COMPARED = {
    ">": np.greater,
    ">=": np.greater_equal,
    "<": np.less,
    "<=": np.less_equal,
}


def _is_so(
    table: _Table, name: str, said: str, beside: str
) -> tuple[FloatArray, tuple[IntArray, ...]]:
    """1 where a condition holds, 0 where it does not or a value is missing; of a bare field its
    own values, NaN where one is missing. And the lists that they are of."""
    if table.has(beside + said) or table.has(said) or _CONDITION.fullmatch(said) is None:
        path, found = table.field(name, said, beside)
        return _numbers(table, name, path, found), found.up
    results, up = [], ()
    for part in re.split(r"\s+and\s+", said):
        match = _CONDITION.fullmatch(part.strip())
        if match is None:
            raise InputError(f"{table.path}: lines: {name}: {part!r} is no condition, e.g. a > 0.5")
        left, operator, right = match[1], match[2].strip(), match[3]
        path, found = table.field(name, left, beside)
        meant = parse_yaml(right, f"{table.path}: lines: {name}")
        among = list(meant) if isinstance(meant, (list, tuple)) else [meant]
        if operator in _COMPARED:
            if not isinstance(meant, (int, float)):
                raise InputError(f"{table.path}: lines: {name}: {right!r} is not a number")
            values = _numbers(table, "number", path, found)
            is_so = _COMPARED[operator](values, meant) & ~np.isnan(values)
        elif any(isinstance(each, str) for each in among):
            text = pc.fill_null(found.values.cast(pa.string()), "")
            is_there = pc.is_valid(found.values).to_numpy(zero_copy_only=False)
            among = [str(each) for each in among]
            is_in = pc.is_in(text, pa.array(among)).to_numpy(zero_copy_only=False)
            is_so = is_there & (is_in == (operator in ("==", "in")))
        else:
            values = _numbers(table, "is_valid" if _is_flag(found) else "number", path, found)
            is_so = np.isin(values, among) == (operator in ("==", "in"))
            is_so &= ~np.isnan(values)
        results.append(is_so)
        up = found.up
        if len(is_so) != len(results[0]):
            raise InputError(f"{table.path}: lines: {name}: {said!r} compares different lists")
    return np.all(results, axis=0).astype(np.float64), up


def _is_flag(found: _Field) -> bool:
    return bool(pa.types.is_boolean(found.values.type))


# --- lines ---------------------------------------------------------------------------------------


def _with_offset(mapping: LinesMapping, table: _Table) -> LinesMapping:
    """The mapping with our own names for the offsets, where it names none."""
    if mapping.offset is not None:
        return mapping
    own = table.own("offset_m")
    wide = [name for name in table.columns if _WIDE.fullmatch(name)]
    if own is None and wide:
        own = f"{wide[0].rpartition('_')[0]}_{{}}"
    if own is None and table.has("lines[].offset_m"):
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


def _beside(path: str, is_points: bool) -> str:
    """The list or section in which a field stands, of points that of the line."""
    if is_points and "[]" in path:
        path = path[: path.rindex("[]")]
    return f"{path.rpartition('.')[0]}." if "." in path else ""


def _rows_of(table: _Table, part: _Part, base: int | None) -> tuple[Cells, IntArray]:
    """The N lines of a part, by our names, and the row of the table of each.

    - base: the number of the first line of a row, from 0; None: as the rows come.
    """
    keys = part.keys
    paths = (keys.offset,) if isinstance(keys.offset, str) else (keys.offset or ())
    section = _beside(paths[0], False)
    first, found = table.field("offset", paths[0])
    offset, up = _numbers(table, "offset_m", first, found), found.up
    for power, path in enumerate(paths[1:], start=1):
        path, found = table.field("offset", path, section)
        values = _spread(
            table, "offset", path, _numbers(table, "offset_m", path, found), found.up, up
        )
        offset = offset + values * keys.at_m**power
    beside = _beside(paths[0], keys.along is not None)
    if keys.along is not None:
        path, found = table.field("along", keys.along, section)
        along = _numbers(table, "along", path, found)
        along = _spread(table, "along", path, along, found.up, up)
        if not up:
            raise InputError(f"{table.path}: lines: along: {first} is no list of points")
        n_lines = len(up[-2]) if len(up) > 1 else table.n_rows
        offset, up = _at(keys.at_m, along, offset, up[-1], n_lines), up[:-1]
    offset = offset / _PER_METRE[keys.unit]
    row = _Field(None, up).rows(table.n_rows) if up else np.arange(table.n_rows)
    cells: Cells = {"offset_m": -offset if keys.left_positive else offset}
    for name in ("is_valid", "is_continuous", "lri", "line"):
        said = getattr(keys, name)
        if isinstance(said, bool):
            cells[name] = np.full(len(offset), float(said))
            continue
        if said is None:
            said = table.own(name, beside) or _of_line(table, name, part.name)
        if said is not None and name in FLAGS:
            values, own_up = _is_so(table, name, said, beside)
            cells[name] = _spread(table, name, said, values, own_up, up)
        elif said is not None:
            path, found = table.field(name, said, beside)
            values = _numbers(table, name, path, found)
            cells[name] = _spread(table, name, said, values, found.up, up)
    if "line" in cells:
        check_whole(table.path, cells, "line", row)
        cells["line"] = cells["line"] + (np.nanmin(cells["line"], initial=1) == 0)
    elif base is not None or up:
        cells["line"] = (base or 0) + 1.0 + np.arange(len(row)) - np.searchsorted(row, row)
    cells.setdefault("is_valid", (~np.isnan(offset)).astype(np.float64))
    if part.slot is not None:
        # A line that is said to be valid is there, and without an offset it is a mistake.
        there = ~np.isnan(offset) | (cells["is_valid"] == 1)
        cells, row = {name: values[there] for name, values in cells.items()}, row[there]
    return cells, row


def _of_line(table: _Table, name: str, line: str) -> str | None:
    """Our own column of a line, in a table with one row per frame."""
    if not line:
        return None
    return table.own(f"{name}_{line}") or table.own(f"{name.removeprefix('is_')}_{line}")


def _spread(
    table: _Table,
    key: str,
    path: str,
    values: FloatArray,
    of: tuple[IntArray, ...],
    up: tuple[IntArray, ...],
) -> FloatArray:
    """Values of lists, or of what these are in, for each element of the offsets' lists."""
    alike = len(of) <= len(up) and all(map(np.array_equal, of, up))
    if not alike:
        raise InputError(f"{table.path}: lines: {key}: {path} has not a value for each offset")
    if len(of) == len(up):
        return values
    index = np.arange(len(up[-1]))
    for each in reversed(up[len(of) :]):
        index = each[index]
    return values[index]


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


def _time_of(table: _Table, mapping: LinesMapping) -> FloatArray | None:
    """The times of the rows, seconds (T,); None where there are none."""
    said = mapping.time or table.own("time_s")
    if mapping.time is None and mapping.frame_id is None and table.has("header.stamp"):
        stamp = _seconds(table, "header.stamp", "s")
        if (np.diff(stamp) >= 0).all() and (len(stamp) < 2 or stamp[-1] > stamp[0]):
            return stamp
        warnings.warn(
            f"{table.path}: the header stamps do not increase; time is when the messages were"
            " recorded",
            UserWarning,
            stacklevel=2,
        )
    unit = mapping.time_unit if mapping.time else "s"
    return None if said is None else _seconds(table, said, unit)


def _seconds(table: _Table, path: str, unit: str) -> FloatArray:
    """A field as times in seconds (T,): numbers of a unit, dates, or stamps."""
    _, found = table.field("time", path)
    values, per = found.values, _PER_SECOND[unit]
    if pa.types.is_struct(values.type):
        names = {f.name for f in values.type}
        of = next((each for each in _STAMPS if {*each} <= names), None)
        if of is None:
            raise InputError(f"{table.path}: lines: time: {path} has {', '.join(sorted(names))}")
        whole, rest = (
            _numbers(table, name, name, replace(found, values=pc.struct_field(values, name)))
            for name in of
        )
        return whole + rest / 1e9
    if pa.types.is_temporal(values.type) and not pa.types.is_duration(values.type):
        values, per = values.cast(pa.timestamp("ns", getattr(values.type, "tz", None))), 10**9
        values = values.cast(pa.int64())
    if pa.types.is_integer(values.type) and not values.null_count:
        # Nanoseconds since 1970 have more digits than a float.
        ticks = values.to_numpy(zero_copy_only=False)
        time_s: FloatArray = ticks // per + ticks % per / per
    else:
        time_s = _numbers(table, "time_s", path, replace(found, values=values)) / per
    if len(time_s) and np.nanmax(np.abs(time_s), initial=0) > 1e11:
        longer = {"s": "ms", "ms": "us"}.get(unit, "ns")
        size = float(np.nanmax(np.abs(time_s))) * per
        longer = "ns" if size > 1e17 else "us" if size > 1e14 else longer
        raise InputError(
            f"{table.path}: {path} is {size:.4g}, which is no time in {unit}; nanoseconds and the"
            f" like: `lines: {{time_unit: {longer}}}`"
        )
    return time_s


def _ids_of(path: Path, time_s: FloatArray) -> FloatArray:
    """Frame ids by the time stamps (T,) of rows; they begin with 0. A step of the median counts as
    one frame, and a longer one as the whole multiple that is nearest to it: gaps stay gaps."""
    if np.isnan(time_s).any():
        raise InputError(f"{place(path, int(np.argmax(np.isnan(time_s))))}: time_s is empty")
    step = np.diff(time_s)
    if (step < 0).any():
        where = place(path, int(np.argmax(step < 0)) + 1)
        raise InputError(f"{where}: is earlier than the one before; sort the table by time")
    later = step[step > 0]
    if not len(later):
        return np.zeros(len(time_s))
    usual = float(np.median(later))
    frames = np.where(step > 0, np.maximum(1, np.rint(step / usual)), 0)
    share = float(np.mean(np.abs(later / usual - np.rint(later / usual)) > _IRREGULAR))
    if share > 0.05:
        warnings.warn(
            f"{NOTE}{path}: {share:.0%} of the steps between its time stamps are no multiple of"
            f" their median, {usual:.4g} s, by which frames are counted",
            UserWarning,
            stacklevel=2,
        )
    return np.concatenate([[0.0], np.cumsum(frames)])


def _frames_of(table: _Table, mapping: LinesMapping) -> Cells:
    """Of each row of a table (T,) the frame id and, where they are known, time and is_missing."""
    said = mapping.frame_id or table.own("frame_id")
    time_s = _time_of(table, mapping)
    cells: Cells = {} if time_s is None else {"time_s": time_s}
    if said is not None:
        path, found = table.field("frame_id", said)
        cells["frame_id"] = _numbers(table, "frame_id", path, found)
        check_whole(table.path, cells, "frame_id", np.arange(table.n_rows))
    elif time_s is not None:
        cells["frame_id"] = _ids_of(table.path, time_s)
    else:
        raise InputError(
            f"{table.path}: no column frame_id{near_word('frame_id', table.columns)}, nor time_s;"
            f" the table has {', '.join(table.columns)}; `lines: {{frame_id: NAME}}` or `{{time:"
            " NAME, time_unit: s}` says what yours is called"
        )
    missing = table.own("is_missing")
    if missing is not None:
        cells["is_missing"] = _numbers(
            table, "is_missing", missing, _follow(table.columns, missing)
        )
    return cells


def lines_of_table(
    columns: Mapping[str, Any],
    mapping: LinesMapping | None,
    path: Path,
    frame_rate: float = FRAME_RATE,
) -> LineLog:
    """The lines of a table, T frames of at most L lines.

    - columns: of pyarrow or pandas, by name; nested ones have fields.
    - path: the file, for messages. frame_rate: frames per second of a table without times.

    Raises InputError for a field that is not there, a cell that does not fit (with its place),
    frames that decrease, a line given twice in a frame, and a valid line without a finite offset.
    """
    whole = whole_mapping(mapping, str(path))
    n_rows = len(next(iter(columns.values()), ()))
    if not columns or not n_rows:
        raise InputError(f"{path}: the table has no rows")
    table = _Table(columns, n_rows, path)
    is_own = whole.offset is None
    tables = {None: table}
    for topic in topics_of(whole):
        tables[topic] = _inside(table, topic)
    whole = _with_offset(whole, tables[next(iter(topics_of(whole)), None)])
    log = _joined(tables, whole, path, frame_rate)
    if is_own:
        _say_ignored(path, [*columns], whole)
    return log


def rate_of_table(
    columns: Mapping[str, Any], mapping: LinesMapping | None, path: Path
) -> float | None:
    """Frames per second by the time stamps of a table; None where it has none."""
    whole = whole_mapping(mapping, str(path))
    n_rows = len(next(iter(columns.values()), ()))
    table = _inside(_Table(columns, n_rows, path), next(iter(topics_of(whole)), ""))
    if n_rows == 0 or not (whole.time or table.own("time_s") or table.has("header.stamp")):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frames = _frames_of(table, whole)
    if "time_s" not in frames:
        return None
    starts = np.diff(frames["frame_id"], prepend=np.nan) != 0
    return rate_of(frames["frame_id"][starts], frames["time_s"][starts])


def _inside(table: _Table, topic: str) -> _Table:
    """The rows of a table that have messages of a topic: a field of that name; without one all."""
    if topic not in table.columns:
        return table
    values = arrow_column(table.columns[topic])
    if not pa.types.is_struct(values.type):
        return table
    there = pc.is_valid(values)
    values = values.filter(there)
    fields = {f.name: pc.struct_field(values, f.name) for f in values.type}
    others = {
        name: arrow_column(column).filter(there)
        for name, column in table.columns.items()
        if name != topic
    }
    return _Table({**others, **fields}, len(values), table.path)


def _say_ignored(path: Path, names: Sequence[str], mapping: LinesMapping) -> None:
    """Warn once of the columns of a table with our names that are not used."""
    known = {*COLUMNS}
    if mapping.offset != "offset_m":
        known = {*_OF_FRAME}
    used = {
        mapping.frame_id,
        mapping.time,
        mapping.line,
        mapping.lri,
        *map(str, _conditions(mapping)),
    }
    wide = r"(offset_m|offset|is_valid|valid|is_continuous|continuous|lri)_\d+"
    others = [
        name + near_word(name, known - {each.casefold() for each in names})
        for name in names
        if name.casefold() not in known
        and name not in used
        and not any(name in str(each) for each in _conditions(mapping))
        and not (mapping.offset != "offset_m" and re.fullmatch(wide, name))
        and not str(mapping.offset).startswith(f"{name}[]")
    ]
    if others:
        warnings.warn(f"{path}: ignored column(s) {', '.join(others)}", UserWarning, stacklevel=4)


def _conditions(mapping: LinesMapping) -> tuple[Any, Any]:
    return mapping.is_valid, mapping.is_continuous


def topics_of(mapping: LinesMapping) -> tuple[str, ...]:
    """The topics that a mapping with its preset's keys names; none: the only one."""
    topic = mapping.topic
    found = [topic.replace("{}", each) for each in mapping.each or ("",)] if topic else []
    found += [str(keys["topic"]) for keys in mapping.also if "topic" in keys]
    return tuple(dict.fromkeys(found))


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
    if not by_topic:
        raise InputError(f"{where}: has no messages")
    wanted = topics_of(whole)
    if not wanted and len(by_topic) > 1:
        raise InputError(f"{where}: topic: is missing; there are {', '.join(sorted(by_topic))}")
    tables: dict[str | None, _Table] = {}
    for topic in wanted or by_topic:
        found = by_topic.get(f"/{topic.strip('/')}")
        if found is None:
            hint = suggestion(topic, by_topic)
            raise InputError(f"{where}: lines: topic: there is no topic {topic}{hint}")
        tables[topic if wanted else None] = _table_of(found, path)
    whole = _with_offset(whole, next(iter(tables.values())))
    return _joined(tables, whole, path, frame_rate)


def _table_of(messages: Sequence[Message], path: Path) -> _Table:
    """The fields of the messages of one topic."""
    try:
        table = pa.Table.from_pylist([dict(message.value) for message in messages])
    except (pa.ArrowException, TypeError, ValueError) as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(
            f"{path}: the messages on {messages[0].topic} are not alike ({said})"
        ) from None
    columns = dict(zip(table.column_names, table.columns, strict=True))
    if "time_s" not in columns:
        columns["time_s"] = pa.array([message.time_s for message in messages])
    return _Table(columns, len(messages), path)


def _joined(
    tables: Mapping[str | None, _Table], mapping: LinesMapping, path: Path, frame_rate: float
) -> LineLog:
    """The lines of all parts of a mapping. tables: of each topic, the first of them for parts
    without one."""
    first = next(iter(tables.values()))
    parts = _parts(mapping, first.columns, str(path))
    frames: dict[int, Cells] = {}
    found: list[tuple[Cells, IntArray]] = []
    used = [tables.get(part.keys.topic) or first for part in parts]
    for table in used:
        if id(table) not in frames:
            frames[id(table)] = _frames_of(table, mapping)
    row_of = {key: np.arange(len(cells["frame_id"])) for key, cells in frames.items()}
    of_frame = next(iter(frames.values()))
    if len(frames) > 1:
        of_frame, row_of = _together(path, frames, by_id=mapping.frame_id is not None)
    base = 0
    for part, table in zip(parts, used, strict=True):
        is_alone = len(parts) == 1 and part.slot is None
        start = part.slot if part.slot is not None and not mapping.also else base
        cells, row = _rows_of(table, part, None if is_alone else start)
        if len(row) and "line" in cells:
            base = max(base, int(np.nanmax(cells["line"], initial=0)))
        found.append((cells, row_of[id(table)][row]))
    cells, row = _stacked(found, len(of_frame["frame_id"]))
    cells |= {name: values[row] for name, values in of_frame.items()}
    if "line" not in cells:
        cells["line"] = _numbered(cells)
    log = _assemble(path, cells, row, frame_rate)
    for said in contradictions(log, parts, mapping):
        warnings.warn(said, UserWarning, stacklevel=4)
    return log


def _stacked(found: Sequence[tuple[Cells, IntArray]], n_rows: int) -> tuple[Cells, IntArray]:
    """The lines of all parts in the order of their rows, of which one without lines has an empty
    one."""
    absent = np.setdiff1d(np.arange(n_rows), np.concatenate([row for _, row in found]))
    blanks = {"is_valid": 1.0, "is_continuous": 0.0, "lri": np.nan}
    names = {name for cells, _ in found for name in cells}
    if len(found) == 1 and not len(absent):
        return found[0]
    row = np.concatenate([*(row for _, row in found), absent])
    cells = {
        name: np.concatenate(
            [
                *(cells.get(name, np.full(len(of), blanks.get(name, 0.0))) for cells, of in found),
                np.full(len(absent), np.nan),
            ]
        )
        for name in names
    }
    order = np.lexsort((cells["line"], row)) if "line" in cells else np.argsort(row, kind="stable")
    return {name: values[order] for name, values in cells.items()}, row[order]


def _together(
    path: Path, frames: Mapping[int, Cells], *, by_id: bool
) -> tuple[Cells, dict[int, IntArray]]:
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
    row_of = {each: at[a:b] for each, a, b in zip(frames, ends, ends[1:], strict=False)}
    values = key[order][is_new]
    found = {name: values}
    return found if by_id else {**found, "frame_id": _ids_of(path, values)}, row_of


def _assemble(path: Path, cells: Cells, row: IntArray, frame_rate: float) -> LineLog:
    """The frames of a table that has a row for each line; row (N,): where each is in the file."""

    def refuse(bad: BoolArray, why: str) -> None:
        """Raise InputError for the first row that is bad; `{}` in `why` becomes its frame id."""
        if bad.any():
            k = int(np.argmax(bad))
            where = place(path, int(row[k]))
            raise InputError(f"{where}: " + why.format(int(cells["frame_id"][k])))

    for name in _OF_FRAME:
        if name in cells and np.isnan(cells[name]).any():
            k = int(np.argmax(np.isnan(cells[name])))
            raise InputError(f"{place(path, int(row[k]))}: {name} is empty")
    check_whole(path, cells, "line", row)
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
    alone = np.bincount(at)[at] == 1
    refuse(
        ~has_line & ~(alone & np.isnan(offset)),
        "frame {} has a row with an empty line, but with an offset or next to other rows",
    )
    key, again = at * MAX_LINES + line, has_line.copy()
    again[np.flatnonzero(has_line)[np.unique(key[has_line], return_index=True)[1]]] = False
    refuse(again, "frame {} has this line twice")
    for name in ("is_valid", "is_continuous"):
        if name in cells:
            refuse(
                np.isnan(cells[name]) & has_line,
                f"frame {{}} has a line with empty {name}; `lines: {{{{{name}: {name} == 1}}}}`"
                " takes it as false",
            )
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


def _numbered(cells: Cells) -> FloatArray:
    """The numbers of the lines of each frame, in the order of the rows; NaN for a row that stands
    for a frame without lines."""
    frame = cells["frame_id"]
    first = np.flatnonzero(np.diff(frame, prepend=np.nan) != 0)
    of_frame = np.diff(first, append=len(frame))
    number = (np.arange(len(frame)) - np.repeat(first, of_frame) + 1).astype(np.float64)
    number[np.isnan(cells["offset_m"]) & (np.repeat(of_frame, of_frame) == 1)] = np.nan
    return number


# --- signs ---------------------------------------------------------------------------------------


def contradictions(log: LineLog, parts: Sequence[_Part], mapping: LinesMapping) -> list[str]:
    """One line for each way in which the signs of the offsets contradict themselves, with what may
    cure it; they are used all the same."""
    offset = np.where(log.is_valid, log.offset_m, np.nan)
    several = log.is_valid.sum(axis=1) > 1
    if several.sum() < _ENOUGH:
        return []
    offset = offset[several]
    turned = "false" if mapping.left_positive else "true"
    cure = f"if they are, `lines: {{left_positive: {turned}}}`"
    mirrored = "positive to the right" if mapping.left_positive else "positive to the left"
    said = []
    low, high = np.nanmin(offset, axis=1), np.nanmax(offset, axis=1)
    one_sided = float(np.mean((low > 0) | (high < 0)))
    if one_sided > _MOST:
        said.append(
            f"{log.source}: in {one_sided:.0%} of the frames all lines are on one side of the car;"
            " are the offsets distances without a sign? `also` takes each side with its own"
            " left_positive"
        )
    sides = {part.name.casefold(): part.slot for part in parts if part.slot is not None}
    left, right = sides.get("left"), sides.get("right")
    if left is not None and right is not None and right < offset.shape[1]:
        swapped = offset[:, left] > offset[:, right]
    else:
        step = np.diff(_packed(offset), axis=1)
        swapped = (np.nan_to_num(step, nan=-1) < 0).all(axis=1)
    if float(np.mean(swapped)) > _MOST:
        said.append(
            f"{log.source}: lines go from right to left in {np.mean(swapped):.0%} of the frames;"
            f" are their offsets {mirrored}? {cure}"
        )
    return said


def _packed(offset: FloatArray) -> FloatArray:
    """The numbers of each row in their order, the gaps between them at the end."""
    order = np.argsort(np.isnan(offset), axis=1, kind="stable")
    return np.take_along_axis(offset, order, axis=1)
