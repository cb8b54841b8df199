"""Types of the parameters of verbs, with their look on the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Ge

from egolane_pgm.types import InputError, LineLog

if TYPE_CHECKING:
    import pandas as pd

    #: Lines of a drive: a file, or data in memory.
    Lines = str | os.PathLike[str] | LineLog | pd.DataFrame
    #: The annotated lanes of a drive; "none" for none.
    Truth = str | os.PathLike[str] | pd.DataFrame
else:
    Lines = Truth = str | os.PathLike[str]

StrPath = str | os.PathLike[str]


@dataclass(frozen=True)
class Option:
    """The look of a verb's parameter on the command line, beyond its name and type.

    - metavar: placeholder of the value in the help.
    - names: further names, "-o", or another long one in place of the parameter's.
    - example: a name and a value, for messages.
    - default: default of the command, if it differs from the function's.
    - shown: text of the default in the help.
    - many: whether it may be repeated.
    - envvar: environment variable that gives it.
    - required: whether a command needs it.
    - hidden: whether it is for Python callers only.
    """

    metavar: str | None = None
    names: tuple[str, ...] = ()
    example: str | None = None
    default: Any = None
    shown: str | None = None
    many: bool = False
    envvar: str | None = None
    required: bool = False
    hidden: bool = False


Hidden = Option(hidden=True)

Progress = Annotated[bool | None, Hidden]
Detector = Annotated[StrPath | None, Option("NAME|FILE.py")]
CameraFile = Annotated[StrPath, Option("FILE", required=True)]
#: Number of folds; 0 for none.
Folds = Annotated[int | None, Ge(0), Option(shown="5")]
Jobs = Annotated[int, Ge(1)]
#: A Dask cluster; see `tools.jobs`.
Cluster = Annotated[str | None, Option("ADDRESS|local:N")]
Graph = Annotated[Any, Option("NAME|FILE")]
#: Columns of a table, or fields of messages; see `recordings.columns`.
ColumnNames = Annotated[
    str | Sequence[str] | Mapping[str, Any] | None, Option("OURS=THEIRS,...", many=True)
]
TableOfRuns = Annotated[StrPath | Any | None, Option("FILE")]
ByTag = Annotated[str | None, Option("NAME")]
Overrides = Annotated[
    Mapping[str, Any] | Sequence[str] | None, Option("KEY=VALUE", names=("--set",), many=True)
]


def several_of(given: Any) -> list[Any]:
    """One or several things as a list."""
    if given is None:
        return []
    return list(given) if isinstance(given, (list, tuple)) else [given]


def path_of(given: Any, what: str) -> str:
    """The name of a file or a folder. Raises InputError for anything else."""
    if isinstance(given, (str, os.PathLike)):
        return os.fspath(given)
    raise InputError(f"{what}: {given!r} is not the name of a file or a folder")


def place_of(out: Any, name: str) -> Path | None:
    """The directory for a result; `*` is replaced with the name. None without `out`."""
    return None if out is None else Path(path_of(out, "out").replace("*", name))


def keys_of(given: Mapping[str, Any] | None, what: str, example: str) -> dict[str, Any]:
    """A dict of names and values. Raises InputError, with the example, for anything else."""
    if given is None or isinstance(given, Mapping):
        return dict(given or {})
    raise InputError(f"{what}: {given!r} is no dict, e.g. {example}")


def shown(path: str | os.PathLike[str]) -> str:
    """A path for printing: relative if it is below the current folder."""
    here = Path.cwd()
    return str(Path(path).relative_to(here) if Path(path).is_relative_to(here) else path)
