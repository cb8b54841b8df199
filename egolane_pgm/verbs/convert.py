"""The verb `convert`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from egolane_pgm.recordings import read_with, write_lines
from egolane_pgm.types import LineLog
from egolane_pgm.verbs.given import ColumnNames, Option, StrPath, path_of

EXAMPLES = ("egolane convert drive/lines.csv lines.parquet",)


def convert(
    source: StrPath,
    target: StrPath,
    *,
    topic: str | None = None,
    format: Annotated[str | None, Option("NAME")] = None,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    frame_rate: float | None = None,
    columns: ColumnNames = None,
    options: Annotated[
        Mapping[str, Any] | None, Option("KEY=VALUE", names=("--set",), example="valid=always")
    ] = None,
) -> LineLog:
    """Convert a recording of lines to .csv, .parquet, .bag or .mcap (ROS 2).

    SOURCE is one of these, a ROS 2 bag, or what another lane detector wrote, which needs a camera:
    TuSimple's JSON lines, a folder of CULane's .lines.txt or of OpenLane's .json.

    - topic: topic of a bag.
    - format: where the extension does not say it.
    - camera: the camera's YAML, for lines given in pixels.
    - frame_rate: frames per second.
    - columns: what a table or messages call our columns, as for `run`.
    - options: a further option of the format, e.g. valid=always for labels.

    Returns the lines. Raises InputError, one line, for whatever does not fit.
    """
    given = {"topic": topic, "camera": camera, "frame_rate": frame_rate, "columns": columns}
    chosen = {key: value for key, value in given.items() if value is not None}
    log = read_with(path_of(source, "source"), format, {**(options or {}), **chosen})
    write_lines(path_of(target, "target"), log)
    return log


def says(done: LineLog, given: Mapping[str, Any]) -> str:
    """Which frames the file has."""
    first, last = int(done.frame_id[0]), int(done.frame_id[-1])
    return f"{given['target']}: {len(done)} frames, ids {first} to {last}"
