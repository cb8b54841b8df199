"""What was driven: recordings of lines, ground truth, the public data sets.

One file per format of recording; `read_lines` picks it by the file's extension.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from egolane_pgm.types import InputError, LineLog, suggestion

#: Format: (extensions, module of this folder, function that reads a file into a LineLog).
FORMATS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "rosbag": ((".bag",), "rosbag", "read_rosbag"),
    "table": ((".csv", ".parquet"), "table", "read_table"),
}

_WRITERS = {"rosbag": ("rosbag_writer", "write_rosbag"), "table": ("table", "write_table")}


def read_lines(path: str | Path, format: str | None = None, **options: Any) -> LineLog:
    """The lines of a recording, T frames of at most L lines, read by the format it has.

    format: a name of FORMATS; None goes by the extension. options: those of the format's reader
    (`read_rosbag`: topic, frame_id, frame_rate; `read_table`: frame_rate).

    Raises InputError for an unknown format, extension or option, and what the reader raises.
    """
    name = _format_of(Path(path)) if format is None else format
    if name not in FORMATS:
        raise InputError(f"{path}: unknown format '{name}'{suggestion(name, FORMATS)}")
    _, module, function = FORMATS[name]
    read = getattr(import_module(f"{__name__}.{module}"), function)
    allowed = set(read.__kwdefaults__)
    for option in options:
        if option not in allowed:
            raise InputError(
                f"{path}: format {name} has no option '{option}'{suggestion(option, allowed)}"
            )
    log: LineLog = read(path, **options)
    return log


def write_lines(path: str | Path, log: LineLog) -> None:
    """Write a log in the format of the file's extension.

    Raises InputError for an unknown extension, and what the writer raises.
    """
    module, function = _WRITERS[_format_of(Path(path))]
    getattr(import_module(f"{__name__}.{module}"), function)(path, log)


def _format_of(path: Path) -> str:
    for name, (extensions, _, _) in FORMATS.items():
        if path.suffix.lower() in extensions:
            return name
    known = "; ".join(f"{name}: {', '.join(ext)}" for name, (ext, _, _) in FORMATS.items())
    raise InputError(
        f"{path}: unknown extension '{path.suffix}' of a recording ({known}); name its format"
    )
