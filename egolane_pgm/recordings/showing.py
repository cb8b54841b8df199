"""What is in a table or a bag, as text, and the command that runs it where that is plain.

Names, units and signs that are not ours are guesses, and each is listed as one. What is not plain
is not guessed: then there is no command.
"""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.columns import contradictions, lines_of_columns, typed
from egolane_pgm.recordings.table import TABLES, read_columns, separator_of
from egolane_pgm.recordings.topics import fields_of, table_of, topics_of
from egolane_pgm.types import FloatArray, InputError

#: Names of columns, without their unit, that mostly mean ours.
_NAMES = {
    "frame_id": ("frame", "frame number", "frame no", "frame index", "image", "image id", "bild"),
    "time_s": ("time", "timestamp", "time stamp", "stamp", "t", "when", "zeit", "zeitstempel"),
    "line": ("line", "line id", "line number", "id", "track", "track id", "linie"),
    "offset_m": ("offset", "lateral", "lateral offset", "lateral position", "lateral distance"),
}

#: How wide lanes, metres, and how far apart frames are, seconds, and the units of them.
_USUAL: dict[str, tuple[float, float, dict[str, float]]] = {
    "offset_m": (2.2, 5.0, {"m": 1, "cm": 100, "mm": 1000}),
    "time_s": (0.004, 3.0, {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}),
}


def show_recording(path: Path) -> str:
    """What is in a table or a bag. Raises InputError for a file that cannot be read."""
    text: list[str] = []
    if path.suffix.lower() in TABLES:
        found = separator_of(path) if path.suffix.lower() == ".csv" and path.is_file() else ","
        said: dict[str, Any] = {} if found == "," else {"separator": found}
        table = read_columns(path, Columns(**said))
        columns = dict(zip(table.column_names, table.columns, strict=True))
        text = [f"{path}: {table.num_rows} rows", *_spans(columns), *_verdict(path, columns, said)]
        return "\n".join(text)
    for topic, (kind, count) in topics_of(path).items():
        text.append(f"{topic} ({kind}): {count} messages")
        if not count or "Image" in kind:
            continue
        try:
            fields = fields_of(path, topic)
        except InputError as error:
            text.append(f"  {error}")
            continue
        text[-1] += f"; {_pace(np.asarray(fields['time_s']))}"
        columns, _ = table_of(fields)
        text += [*_spans(columns), *_verdict(path, columns, {}, topic)]
    return "\n".join(text or [f"{path}: has no topics"])


def _numbers(column: Any) -> FloatArray | None:
    """A column as numbers, None where it has others."""
    try:
        return typed(Path(), "lri", column)
    except InputError:
        return None


def _spans(columns: Mapping[str, Any]) -> Iterator[str]:
    for name, column in columns.items():
        values = _numbers(column)
        if values is None or np.isnan(values).all():
            said = ", ".join(dict.fromkeys(str(cell)[:25] for cell in column[:3]))
        else:
            said = f"{np.nanmin(values):.10g} to {np.nanmax(values):.10g}"
        yield f"  {name:<24} {said}"


def _pace(time_s: FloatArray) -> str:
    """The rate of times, and their gaps."""
    step = np.diff(time_s)
    if not (step > 0).any():
        return "no rate (time stands still)"
    usual = float(np.median(step[step > 0]))
    gap = step > 1.5 * usual
    return f"{1 / usual:.4g} per second, gaps: {gap.sum()}" + (
        f" (the longest {step.max():.3g} s)" if gap.any() else ""
    )


def _verdict(
    path: Path, columns: Mapping[str, Any], said: dict[str, Any], topic: str | None = None
) -> list[str]:
    """What would run a table or a topic, with every guess in it; or why nothing plainly would."""
    options: dict[str, Any] = {} if topic is None else {"topic": topic}
    try:
        is_published = {"way_id", "line"} <= columns.keys()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            keys, guesses = (said, []) if is_published else _guessed(path, columns, said)
            caught.clear()
            log = read_lines(path, columns=keys, **options)
        if not log.is_valid.any() or "one-sided" in contradictions(log):
            raise InputError("the offsets are not those of lines on both sides of the car")
    except InputError as error:
        why = str(error).removeprefix(f"{path}: ")
        return [f"  no command, since what is a line here is not plain: {why}"]
    words = [f"{k}=[{','.join(v)}]" if isinstance(v, list) else f"{k}={v}" for k, v in keys.items()]
    options |= {"columns": ",".join(words)} if words else {}
    given = "".join(f" --{name} {shlex.quote(value)}" for name, value in options.items())
    valid = log.offset_m[log.is_valid]
    # Times of the published ROS 1 type are not believed.
    is_timed = "time_s" in {*keys, *columns} and not (is_published and path.suffix == ".bag")
    rate = _pace(log.time_s) if is_timed else f"no times, gaps: {(np.diff(log.frame_id) > 1).sum()}"
    return [
        f"  {len(log)} frames, {rate}; lines from {valid.min():.2f} to {valid.max():.2f} m",
        *(f"  warning: {str(each.message).removeprefix(f'{path}: ')}" for each in caught),
        *(f"  guess: {each}" for each in guesses),
        f"  {'if the guesses are right' if guesses else 'to run it'} (N: the lanes of the road):",
        f"  egolane run {shlex.quote(str(path))} --n-lanes N{given}",
    ]


def _guessed(
    path: Path, columns: Mapping[str, Any], said: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """The columns that names plainly mean, with units and sign, and the guesses in them. Raises
    InputError where several may be meant, or a unit or the sign is not plain."""
    keys, guesses, plain = {**said}, [], {}
    for name in columns:
        last = re.sub(r"([a-z])([A-Z])", r"\1 \2", name.rpartition(".")[2]).lower()
        match = re.fullmatch(r"(.+?)[\W_]+(s|ms|us|ns|m|cm|mm)\W*", last)
        word, unit = match.groups() if match else (last, "")
        plain[name] = " ".join(re.findall(r"[^\W_]+", word)), unit
    known = {name.casefold() for name in columns}
    known |= {"offset_m" for name in known if re.fullmatch(r"offset_(m_)?\d+", name)}
    for ours, words in _NAMES.items():
        theirs = [name for name, (word, _) in plain.items() if word in words]
        if len(theirs) > 1 and ours not in known:
            raise InputError(f"{ours} may be {' or '.join(theirs)}")
        if theirs and ours not in known:
            keys[ours] = theirs[0]
            guesses.append(f"{ours} is {theirs[0]}, by its name")
    rest = ("", *_NAMES["offset_m"])
    sides = [
        [n for n, (w, _) in plain.items() if side in w and w.replace(side, "").strip() in rest]
        for side in ("left", "right")
    ]
    if not {"offset_m"} & {*keys, *known} and [len(side) for side in sides] == [1, 1]:
        keys["offset_m"] = [side[0] for side in sides]
        guesses.append(f"offset_m is {' and '.join(keys['offset_m'])}, by their names")
    if not {"offset_m"} & {*keys, *known}:
        raise InputError("no name is plainly that of an offset")
    if "time_s" in keys and (times := _numbers(columns[keys["time_s"]])) is not None:
        keys |= _unit("time_s", "time_unit", plain[keys["time_s"]][1], np.diff(times), guesses)
    if "offset_m" in keys:
        rows = np.arange(len(next(iter(columns.values()))))
        log = lines_of_columns(columns, Columns(**keys), path, row=rows)
        steps = np.diff(np.sort(np.where(log.is_valid, log.offset_m, np.nan), axis=1), axis=1)
        unit = plain[keys["offset_m"] if isinstance(keys["offset_m"], str) else sides[0][0]][1]
        keys |= _unit("offset_m", "unit", unit, steps, guesses)
        ways = (log, replace(log, offset_m=-log.offset_m))
        is_turned, is_not = ("backwards" in contradictions(way) for way in ways)
        if not (is_turned or is_not):
            raise InputError("the data do not show whether offsets are positive to the left")
        keys |= {"left_positive": "true"} if is_turned else {}
        side = "left" if is_turned else "right"
        guesses.append(f"positive offsets are to the {side}: then lines go from left to right")
    return keys, guesses


def _unit(ours: str, key: str, unit: str, steps: FloatArray, guesses: list[str]) -> dict[str, str]:
    """The unit of a name or, where that has none, the one in which steps are usual ones, unless it
    is ours."""
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    low, high, per = _USUAL[ours]
    fits = [each for each, n in per.items() if low < usual / n < high]
    if not unit and not fits:
        raise InputError(f"the unit of {ours} is not plain")
    guesses.append(f"{ours} is in {unit or fits[0]}, by its {'name' if unit else 'values'}")
    return {} if (unit or fits[0]) in ("m", "s") else {key: unit or fits[0]}
