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
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.table import TABLES, read_columns
from egolane_pgm.recordings.topics import fields_of, table_of, topics_of
from egolane_pgm.types import FloatArray, InputError

#: Names of columns, without their unit, that mostly mean ours.
_NAMES = {
    "frame_id": ("frame", "framenumber", "framenr", "frameindex", "image", "imageid"),
    "time_s": ("time", "timestamp", "stamp", "t"),
    "line": ("line", "lineid", "linenumber", "id", "track", "trackid"),
    "offset_m": ("offset", "lateral", "lateraloffset", "lateralposition", "lateraldistance"),
}

#: The unit at the end of a name.
_UNIT = re.compile(r"(.+?)[\W_]+(s|ms|us|ns|m|cm|mm)\W*")

#: How far apart frames are, seconds, and how wide lanes, metres, and the units of them.
_USUAL: dict[str, tuple[float, float, dict[str, float]]] = {
    "time_s": (0.004, 3.0, {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}),
    "offset_m": (2.2, 5.0, {"m": 1, "cm": 100, "mm": 1000}),
}


def show_recording(path: Path) -> str:
    """What is in a table or a bag. Raises InputError for a file that cannot be read."""
    if path.suffix.lower() in TABLES:
        table = read_columns(path)
        columns = dict(zip(table.column_names, table.columns, strict=True))
        text = [f"{path}: {table.num_rows} rows", *_spans(columns), *_verdict(path, columns)]
        return "\n".join(text)
    text = []
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
        text += [*_spans(columns), *_verdict(path, columns, topic)]
    return "\n".join(text or [f"{path}: has no topics"])


def _spans(columns: Mapping[str, Any]) -> Iterator[str]:
    for name, column in columns.items():
        try:
            values = typed(Path(), "lri", column)
            known = values[~np.isnan(values)]
            span = f"{known.min():.10g} to {known.max():.10g}"
        except (InputError, ValueError):
            span = ", ".join(dict.fromkeys(str(cell)[:25] for cell in column[:3]))
        yield f"  {name:<24} {span}"


def _pace(time_s: FloatArray) -> str:
    """The rate of times, and their gaps."""
    step = np.diff(time_s)
    if not (step > 0).any():
        return "no rate (time stands still)"
    usual = float(np.median(step[step > 0]))
    gap = step > 1.5 * usual
    longest = f" (the longest {step.max():.3g} s)" if gap.any() else ""
    return f"{1 / usual:.4g} per second, gaps: {gap.sum()}{longest}"


def _verdict(path: Path, columns: Mapping[str, Any], topic: str | None = None) -> list[str]:
    """What would run a table or a topic, with every guess in it; or why nothing plainly would."""
    options: dict[str, Any] = {} if topic is None else {"topic": topic}
    guesses: list[str] = []
    keys: dict[str, Any] = {}
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                log = read_lines(path, **options)
            except InputError:
                keys = _guessed(path, columns, guesses)
                caught.clear()
                log = read_lines(path, columns=keys, **options)
        if not log.is_valid.any() or "one-sided" in contradictions(log):
            raise InputError("the offsets are not those of lines on both sides of the car")
    except InputError as error:
        why = str(error).removeprefix(f"{path}: ")
        return [f"  no command, since what is a line here is not plain: {why}"]
    words = [f"{key}={value}" for key, value in keys.items()]
    options |= {"columns": ",".join(words)} if words else {}
    given = "".join(f" --{name} {shlex.quote(value)}" for name, value in options.items())
    valid = log.offset_m[log.is_valid]
    n_gaps = (np.diff(log.frame_id) > 1).sum()
    return [
        f"  {len(log)} frames, {rate_of(log.frame_id, log.time_s)} per second, gaps: {n_gaps};"
        f" lines from {valid.min():.2f} to {valid.max():.2f} m",
        *(f"  warning: {str(each.message).removeprefix(f'{path}: ')}" for each in caught),
        *(f"  guess: {each}" for each in guesses),
        f"  {'if the guesses are right' if guesses else 'to run it'} (N: the lanes of the road):",
        f"  egolane run {shlex.quote(str(path))} --n-lanes N{given}",
    ]


def _guessed(path: Path, columns: Mapping[str, Any], guesses: list[str]) -> dict[str, Any]:
    """The columns that names plainly mean, with units and sign; append each guess to `guesses`.
    Raises InputError where several may be meant, or a unit or the sign is not plain."""
    keys: dict[str, Any] = {}
    plain, units = {}, {}
    for name in columns:
        last = re.sub(r"([a-z])([A-Z])", r"\1_\2", name.rpartition(".")[2]).lower()
        match = _UNIT.fullmatch(last)
        word, units[name] = match.groups() if match else (last, "")
        plain[name] = re.sub(r"[\W_]", "", word)
    for ours, words in _NAMES.items():
        theirs = [name for name, word in plain.items() if word in words]
        if ours in columns or not theirs:
            continue
        if len(theirs) > 1:
            raise InputError(f"{ours} may be {' or '.join(theirs)}")
        keys[ours] = theirs[0]
        guesses.append(f"{ours} is {theirs[0]}, by its name")
    if not {"offset_m", "offset_1"} & {*keys, *columns}:
        raise InputError("no name is plainly that of an offset")
    if "time_s" in keys:
        times = typed(path, "time_s", columns[keys["time_s"]])
        unit = _unit("time_s", units[keys["time_s"]], np.diff(times), guesses)
        keys |= {"time_unit": unit} if unit != "s" else {}
    if "offset_m" in keys:
        rows = np.arange(len(next(iter(columns.values()))))
        log = lines_of_columns(columns, Columns(**keys), path, row=rows)
        steps = np.diff(np.sort(np.where(log.is_valid, log.offset_m, np.nan), axis=1), axis=1)
        unit = _unit("offset_m", units[keys["offset_m"]], steps, guesses)
        keys |= {"unit": unit} if unit != "m" else {}
        ways = (log, replace(log, offset_m=-log.offset_m))
        is_turned, is_not = ("backwards" in contradictions(way) for way in ways)
        if not (is_turned or is_not):
            raise InputError("the data do not show whether offsets are positive to the left")
        keys |= {"left_positive": "true"} if is_turned else {}
        side = "left" if is_turned else "right"
        guesses.append(f"positive offsets are to the {side}: then lines go from left to right")
    return keys


def _unit(ours: str, unit: str, steps: FloatArray, guesses: list[str]) -> str:
    """The unit of a name or, if that has none, the one in which the median step is a usual one."""
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    low, high, per = _USUAL[ours]
    fits = [unit] if unit else [each for each, n in per.items() if low < usual / n < high]
    if not fits:
        raise InputError(f"the unit of {ours} is not plain")
    guesses.append(f"{ours} is in {fits[0]}, by its {'name' if unit else 'values'}")
    return fits[0]
