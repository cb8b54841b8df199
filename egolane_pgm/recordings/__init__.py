"""Recordings of lines, ground truth, and the public data sets.

One module per format of recording; `read_lines` chooses it by the file's extension.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.types import InputError, LineLog, problems_in, suggestion

if TYPE_CHECKING:
    from egolane_pgm.recordings.columns import ColumnsGiven

#: Format: (extensions, module, function that reads a file into a LineLog).
FORMATS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "rosbag": ((".bag", ".mcap", ".db3"), "recordings.topics", "read_topic"),
    "table": ((".csv", ".tsv", ".parquet"), "recordings.table", "read_table"),
    "tusimple": ((".jsonl", ".json"), "vision.formats.tusimple", "read_tusimple"),
}

#: Extensions of picture files and of videos.
PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm", ".ts", ".mts", ".mpg", ".mpeg", ".wmv")

#: Extensions of the files in a folder that is a bag.
_IN_BAGS = (".mcap", ".db3", ".zstd", ".bag")


def read_lines(
    path: str | Path,
    /,
    *,
    format: str | None = None,
    camera: object = None,
    frame_rate: float | None = None,
    columns: ColumnsGiven | None = None,
    **options: Any,
) -> LineLog:
    """Read a recording of lines, T frames of at most L lines.

    - format: a name of FORMATS; by default by extension, also of the files in a folder.
    - camera: a camera or its YAML file, for lines in pixels; lines in metres need none.
    - frame_rate: frames per second of a recording without times; by default the reader's.
    - columns: names and units of a table's columns, or of messages' fields: keys and values of
      `recording.columns`, or `"offset_m=lateral,left_positive=true"`.
    - options: further ones of the format's reader (`read_topic`: topic; `read_tusimple`:
      valid, frame_step).

    Raises InputError for an unknown format, extension or option, and as the reader.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ego.simulate("a4", frames=30).log.to_pandas().to_csv(f"{folder}/lines.csv")
    ...     lines = ego.read_lines(f"{folder}/lines.csv")
    >>> len(lines), lines.to_pandas().columns.to_list()
    (30, ['time_s', 'offset_m', 'is_valid', 'is_continuous', 'lri'])
    """
    name = format_of(path) if format is None else format
    with problems_in(str(path)):
        read = reader_of(name)
    allowed = set(read.__kwdefaults__)
    # A camera is ignored by formats in metres.
    options |= {"camera": camera} if "camera" in allowed else {}
    options |= {"frame_rate": frame_rate, "columns": columns}
    given = {key: value for key, value in options.items() if value is not None}
    for option in given.keys() - allowed:
        raise InputError(
            f"{path}: format {name} has no option '{option}'{suggestion(option, allowed)}"
        )
    if columns is not None:
        from egolane_pgm.experiment import CheckedColumns, validated
        from egolane_pgm.recordings.columns import column_keys

        given["columns"] = validated(CheckedColumns, column_keys(columns), f"{path}: columns")
    if frame_rate is not None and not 0 < frame_rate < np.inf:
        raise InputError(f"{path}: frame_rate: {frame_rate!r} is not a number greater than 0")
    log: LineLog = read(path, **given)
    return log


def files_of(folder: Path) -> list[Path]:
    """The files of a folder that is a recording: all files of a bag, else all files."""
    files = sorted(path for path in folder.iterdir() if path.is_file())
    return [path for path in files if path.suffix in _IN_BAGS] or files


def is_pictures(path: str | Path) -> bool:
    """Whether a path is a video, a picture, a folder of pictures or a pattern of pictures."""
    path = Path(path)
    if path.is_dir():
        return any(file.suffix.lower() in PICTURES for file in files_of(path))
    return path.suffix.lower() in (*PICTURES, *VIDEOS)


def reader_of(name: str) -> Any:
    """The function that reads a format; its keyword arguments are the format's options."""
    if name not in FORMATS:
        raise InputError(f"unknown format '{name}'{suggestion(name, FORMATS)}")
    _, module, function = FORMATS[name]
    return getattr(import_module(f"egolane_pgm.{module}"), function)


def format_of(path: str | Path) -> str:
    """The format of a recording by its extension, or by the files in a folder.

    Raises InputError for an unknown one.
    """
    path = Path(path)
    for name, (extensions, _, _) in FORMATS.items():
        if (path.suffix.lower() or path.name) in extensions:
            return name
    if path.is_dir():
        if any(file.suffix in _IN_BAGS for file in files_of(path)):
            return "rosbag"
        if not files_of(path):
            raise InputError(f"{path}: a folder without files; give a file or folder in it")
        raise InputError(
            f"{path}: a folder without a bag ({', '.join(f'*{e}' for e in _IN_BAGS)}); pictures"
            " need a detector (recording.detector)"
        )
    raise InputError(
        f"{path}: unknown extension '{path.suffix}' of a recording ({known_formats()}); name its"
        " format, or of a video a detector (recording.detector); save a spreadsheet as CSV"
    )


def known_formats() -> str:
    """The formats with their extensions, for messages."""
    return "; ".join(f"{name}: {', '.join(each[0])}" for name, each in FORMATS.items())
