"""Damages files: their bytes, their words, and what they say.

Everything is drawn from a `random.Random`, so that a seed gives the same damage again.
"""

from __future__ import annotations

import copy
import datetime
import json
import re
import sqlite3
import string
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pyarrow as pa
import yaml
from pyarrow import parquet

#: Words that programs have stumbled over, put in the place of others.
WORDS = (
    *("", " ", "0", "-1", "1e3", "1e300", "1e-320", "nan", "inf", "-inf", "NaN", "-0", "0x1F"),
    *("010", "9223372036854775807", "9223372036854775808", "-9223372036854775809", "4294967296"),
    *("9" * 400, "1000", "1000000", "1000000000000", "1_000", "1,5", "١٢", "½", "true", "null"),
    *("~", "None", "2020-01-01", "2020-99-99", "12:30", "!!int x", "!!set {a}", "&a [*a]", "*a"),
    *("<<: 3", "? [1]", "[" * 900, "{" * 900, "(" * 900, "a" * 70_000, "\0", "\ufeff", "\ud800"),
    *("\x1b[31m", "\r", "\t", "../..", "/dev/zero", "~nobody/x", "~", ".", "a\0b", "con:"),
    *("file:///etc/passwd", "%n%s%x", "'", '"', ";", ",", "=", "<a>", "&lol;", "\\", "\n", "#"),
    *("|", "n_lanes", "Lane -> Lane", "1 - p1"),
)

#: Values of all types that a file might have in the place of others.
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, 2, -1, 3, 50, 51, 1000, 10**6, 2**31, 2**53, 10**17, 2**63),
    *(-(2**63), 0.5, -0.0, 1e-320, 1e300, 1e17, 0.1, float("nan"), float("inf"), float("-inf")),
    *([], [[]], [0], [1, 2], [2, 1], [0, 10**12], [None], [1.5] * 1000, [[1, 2], [3]], {}),
    *({"": 1}, {"a": {"a": {"a": 1}}}, {"from_frame": 10**30}, datetime.date(2020, 1, 1), *WORDS),
)


def damaged(file: Path, rng: Random) -> bytes:
    """The content of a file, damaged in a way that suits its kind."""
    content = file.read_bytes()
    kinds: list[Callable[[bytes, Random], bytes]] = [_bytes, _words, _meaning_of(file)]
    try:
        return rng.choices(kinds, (2, 2, 4))[0](content, rng)
    except (ValueError, TypeError, pa.ArrowException, sqlite3.Error):
        # Not everything can be written in every format.
        return _bytes(content, rng)


# --- bytes ---------------------------------------------------------------------------------------


def _bytes(content: bytes, rng: Random) -> bytes:
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        # What a file is about mostly stands at its beginning.
        at = rng.randrange(rng.choice((len(data), min(len(data), 256))) + 1)
        size = rng.choice((1, 1, 2, 4, 8, rng.randrange(1, 4096)))
        other = rng.randrange(len(data) + 1)
        how = rng.randrange(8)
        if how == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            data[at : at + size] = rng.randbytes(min(size, 64))
        elif how == 2:
            data[at:at] = rng.randbytes(min(size, 64))
        elif how == 3:
            del data[at : at + size]
        elif how == 4:
            data[at:at] = data[other : other + size]
        elif how == 5:
            del data[at:]
        elif how == 6:
            word = rng.choice(WORDS).encode(errors="surrogatepass")
            data[at : at + rng.choice((0, len(word)))] = word
        else:
            number = rng.choice((0, 1, 2**7, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1))
            wide = rng.choice((1, 2, 4, 8))
            order = rng.choice(("little", "big"))
            data[at : at + wide] = (number % 2 ** (8 * wide)).to_bytes(wide, order)
    return bytes(data)


# --- words ---------------------------------------------------------------------------------------

_BETWEEN = re.compile(rb"([\s,;:=<>\"'\[\]{}()|]+)")


def _words(content: bytes, rng: Random) -> bytes:
    """The words of a text, and the rest of a file that is none, replaced, left out, exchanged."""
    words = _BETWEEN.split(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        at, other = rng.randrange(len(words)), rng.randrange(len(words))
        how = rng.randrange(5)
        if how < 2:
            words[at] = rng.choice(WORDS).encode(errors="surrogatepass")
        elif how == 2:
            words[at] = b""
        elif how == 3:
            words[at] = words[other]
        else:
            words[at], words[other] = words[other], words[at]
    return b"".join(words)


# --- what a file says ----------------------------------------------------------------------------


def _meaning_of(file: Path) -> Callable[[bytes, Random], bytes]:
    """How what a file says is damaged, by its ending."""
    return {
        ".yaml": _yaml,
        ".json": _json,
        ".jsonl": _json_lines,
        ".journal": _json_lines,
        ".parquet": _parquet,
        ".csv": _csv,
        ".db": _database(file),
        ".db3": _database(file),
    }.get(file.suffix, _bytes)


def _yaml(content: bytes, rng: Random) -> bytes:
    text = yaml.safe_dump(_tree(yaml.safe_load(content), rng), sort_keys=False)
    return text.encode(errors="surrogatepass")


def _json(content: bytes, rng: Random) -> bytes:
    return json.dumps(_tree(json.loads(content), rng), default=str).encode()


def _json_lines(content: bytes, rng: Random) -> bytes:
    lines = content.splitlines()
    at = rng.randrange(len(lines))
    lines[at] = _json(lines[at], rng)
    return b"\n".join(lines) + b"\n"


def _tree(tree: Any, rng: Random) -> Any:
    """A tree of dicts and lists with some values replaced, left out, exchanged or wrapped."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        tree = copy.deepcopy(tree)
        places = _places(tree)
        if not places:
            return rng.choice(VALUES)
        section, key = rng.choice(places)
        other, other_key = rng.choice(places)
        how = rng.randrange(9)
        if how < 4:
            section[key] = _near(section[key], rng) if how == 0 else rng.choice(VALUES)
        elif how == 4:
            del section[key]
        elif how == 5:
            section[key] = copy.deepcopy(other[other_key])
        elif how == 6:
            section[key] = rng.choice(([section[key]], {"a": section[key]}, [section[key]] * 60))
        elif how == 7 and isinstance(section, dict):
            section[rng.choice((*WORDS[:20], f"{key}x", rng.choice(string.ascii_letters)))] = 1
        elif isinstance(section, list):
            section.insert(key, rng.choice(VALUES))
    return tree


def _near(value: Any, rng: Random) -> Any:
    """Something like the value."""
    if isinstance(value, (int, float)):
        return rng.choice((-value, value + 1, value * 1000, value / 3, [value], str(value), 1e9))
    return _words(value.encode(), rng).decode(errors="replace") if isinstance(value, str) else value


def _places(tree: Any) -> list[tuple[Any, Any]]:
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    found = []
    for key in keys:
        found.append((tree, key))
        if isinstance(tree[key], (dict, list)):
            found += _places(tree[key])
    return found


def _csv(content: bytes, rng: Random) -> bytes:
    """A table with cells, rows or columns replaced, left out, repeated, exchanged."""
    rows = [line.split(b",") for line in content.splitlines()]
    for _ in range(rng.choice((1, 1, 2, 3))):
        row, other = rng.randrange(len(rows)), rng.randrange(len(rows))
        cell = rng.randrange(max(len(rows[row]), 1))
        word = rng.choice(WORDS).encode(errors="surrogatepass")
        how = rng.randrange(6)
        if how < 2:
            rows[row][cell : cell + 1] = [word]
        elif how == 2:
            rows[row], rows[other] = rows[other], rows[row]
        elif how == 3:
            rows[row:row] = [list(rows[other])]
        elif how == 4:
            rows = [[*line[:cell], *line[cell + 1 :]] for line in rows]
        else:
            rows = [[*line[:cell], word, *line[cell + 1 :]] for line in rows]
    return b"\n".join(b",".join(row) for row in rows) + b"\n"


_TYPES = (
    *(pa.string(), pa.large_string(), pa.binary(), pa.bool_(), pa.int8(), pa.uint64(), pa.int64()),
    *(pa.float16(), pa.float64(), pa.date32(), pa.timestamp("ns"), pa.decimal128(38, 2), pa.null()),
    *(pa.list_(pa.int64()), pa.struct([("a", pa.int64())]), pa.dictionary(pa.int32(), pa.string())),
)  # fmt: skip


def _parquet(content: bytes, rng: Random) -> bytes:
    """A table with columns of another type or name, or left out or repeated, and other cells."""
    table = parquet.read_table(pa.BufferReader(content))
    for _ in range(rng.choice((1, 1, 2))):
        if not table.num_columns:
            break
        k = rng.randrange(table.num_columns)
        name, column = table.column_names[k], table.column(k)
        how = rng.randrange(7)
        if how == 0:
            table = table.remove_column(k)
        elif how == 1:
            table = table.add_column(k, rng.choice(table.column_names), column)
        elif how == 2:
            names = list(table.column_names)
            names[k] = rng.choice((*WORDS[:20], "\x80", "a b", names[rng.randrange(len(names))]))
            table = table.rename_columns(names)
        elif how == 3:
            rows = [rng.randrange(len(table)) for _ in range(len(table))] if len(table) else []
            table = table.take(rows[: rng.choice((0, 1, len(rows)))])
        elif how == 4:
            values = column.to_pylist()
            for _ in range(rng.choice((1, 3))):
                if values:
                    values[rng.randrange(len(values))] = rng.choice((None, *_cells(column.type)))
            table = table.set_column(k, name, pa.array(values, column.type))
        else:
            table = table.set_column(k, name, _converted(column, rng.choice(_TYPES)))
    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink)
    made: bytes = sink.getvalue().to_pybytes()
    # A name that is no UTF-8, which a writer refuses.
    return made.replace(b"frame_id", b"frame_\xff\xfe") if rng.random() < 0.05 else made


def _cells(kind: pa.DataType) -> tuple[Any, ...]:
    if pa.types.is_floating(kind):
        return float("nan"), float("inf"), -1.0, 1e300, 1e9, 0.5, 1e-320
    if pa.types.is_integer(kind):
        return 0, -1, 7, 1000, 2**31 - 1, 2**62, -(2**62)
    return (True, False) if pa.types.is_boolean(kind) else ()


def _converted(column: Any, kind: pa.DataType) -> Any:
    try:
        return column.cast(kind, safe=False)
    except pa.ArrowException:
        texts = column.cast(pa.string(), safe=False) if kind == pa.binary() else None
        return pa.nulls(len(column), kind) if texts is None else texts.cast(kind)


def _database(file: Path) -> Callable[[bytes, Random], bytes]:
    def changed(content: bytes, rng: Random) -> bytes:
        """The tables of SQLite with other cells, without rows, or without one of them."""
        with sqlite3.connect(file) as database:
            there = database.execute("select name from sqlite_master where type = 'table'")
            table = rng.choice([name for (name,) in there])
            names = [row[1] for row in database.execute(f"pragma table_info('{table}')")]
            column, how = rng.choice(names), rng.randrange(6)
            if how == 0:
                database.execute(f"drop table '{table}'")
            elif how == 1:
                database.execute(f"delete from '{table}'")
            elif how == 2:
                database.execute(f"alter table '{table}' rename column '{column}' to 'c{how}'")
            else:
                value = rng.choice([v for v in VALUES if _is_cell(v)])
                where = "" if how == 3 else f"where rowid = {rng.randrange(1, 20)}"
                database.execute(f'update or ignore "{table}" set "{column}" = ? {where}', (value,))
        database.close()
        return file.read_bytes()

    return changed


def _is_cell(value: Any) -> bool:
    is_text = isinstance(value, str) and "\ud800" not in value
    return is_text or (isinstance(value, (int, float)) and abs(value) < 2**63) or value is None
