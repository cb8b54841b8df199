"""Describe a recording as text, with the command that runs it if it has our names."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.recordings import format_of, read_lines
from egolane_pgm.recordings.columns import to_numbers
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.recordings.table import read_columns
from egolane_pgm.recordings.topics import fields_of, table_of, topics_of
from egolane_pgm.types import InputError


def show_recording(path: Path) -> str:
    """Describe a recording. Raises InputError for another file and for a damaged one."""
    format = format_of(path)
    if format == "table":
        table = read_columns(path)
        return "\n".join([f"{path}: {len(table)} rows", *_spans(table), *_command(path)])
    if format != "rosbag":
        return "\n".join([f"{path}: format {format}", *_command(path)])
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
        time_s = np.asarray(fields["time_s"])
        rate = rate_of(np.arange(len(time_s)), time_s)
        text[-1] += f"; {_pace(rate, (np.diff(time_s) * (rate or 0) > 1.5).sum())}"
        text += [*_spans(table_of(fields)), *_command(path, topic=topic)]
    return "\n".join(text or [f"{path}: has no topics"])


def _spans(table: pd.DataFrame) -> Iterator[str]:
    """A line per column: smallest and largest number, counts of a flag, or the first cells."""
    for name, column in table.items():
        is_flag = pd.api.types.infer_dtype(column) == "boolean"
        try:
            values = to_numbers(Path(), "", column, kind="flag" if is_flag else "number")
            known = values[~np.isnan(values)]
            span = f"{known.min():.10g} to {known.max():.10g}"
            if is_flag:
                span = f"true in {int(known.sum()):,} of {len(known):,}"
        except (InputError, ValueError):
            span = ", ".join(dict.fromkeys(str(cell)[:25] for cell in column[:3]))
        yield f"  {name:<24} {span}"


def _pace(rate: float | None, n_gaps: int) -> str:
    return f"{f'{rate:.4g} per second' if rate else 'time stands still'}, gaps: {n_gaps}"


def _command(path: Path, **options: Any) -> list[str]:
    """The command that runs a table or topic with our names, or the reason why none does."""
    try:
        log = read_lines(path, **options)
    except InputError as error:
        why = str(error).removeprefix(f"{path}: ")
        return [f"  to run it: {why}"]
    given = "".join(
        f" --set recording.{name}={shlex.quote(value)}" for name, value in options.items()
    )
    pace = _pace(rate_of(log.frame_id, log.time_s), (np.diff(log.frame_id) > 1).sum())
    return [
        f"  {len(log)} frames, {pace}",
        "  to run it (N: number of lanes of the road):",
        f"  egolane run {shlex.quote(str(path))} --n-lanes N{given}",
    ]
