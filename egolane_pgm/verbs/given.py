"""What verbs take: kinds of parameters, and how those look on the command line that their name and
type do not say."""

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

    #: Lines of a drive: a file, or what is in memory.
    Lines = str | os.PathLike[str] | LineLog | pd.DataFrame
    #: The annotated lanes of a drive; "none" for none.
    Truth = str | os.PathLike[str] | pd.DataFrame
else:
    Lines = Truth = str | os.PathLike[str]

StrPath = str | os.PathLike[str]


@dataclass(frozen=True)
class Option:
    """How a parameter of a verb looks on the command line.

    - metavar: stands for its value in the help; "-" for none.
    - names: "-o" beside the long one, or in place of it one of another name: "--outline".
    - example: of a name and a value, for messages.
    - default: what a command takes where the verb is given nothing. said: shows what that means.
    - many: whether it is given several times, or several arguments.
    - envvar: a variable of the environment that gives it.
    - required: whether a command needs it.
    - hidden: whether a command does not have it.
    """

    metavar: str | None = None
    names: tuple[str, ...] = ()
    example: str | None = None
    default: Any = None
    said: str | None = None
    many: bool = False
    envvar: str | None = None
    required: bool = False
    hidden: bool = False


#: What only Python callers say.
Hidden = Option(hidden=True)

Progress = Annotated[bool | None, Hidden]
Blocks = Annotated[int, Ge(2)]
Seed = Annotated[int, Ge(0)]
Detector = Annotated[StrPath | None, Option("NAME|FILE.py")]
CameraFile = Annotated[StrPath, Option("FILE", required=True)]
#: Blocks that are held out, 0 for none.
HeldOutBlocks = Annotated[int, Ge(0)]
Jobs = Annotated[int, Ge(1)]
#: A Dask cluster; see `tools.jobs`.
Cluster = Annotated[str | None, Option("ADDRESS|local:N")]
Graph = Annotated[Any, Option("NAME|FILE")]
#: Which columns of a table, or fields of messages, are what; see `recordings.columns`.
ColumnNames = Annotated[
    str | Sequence[str] | Mapping[str, Any] | None, Option("OURS=THEIRS,...", many=True)
]
Frames = Annotated[tuple[int, int] | None, Option("FIRST STOP")]
TableOfRuns = Annotated[StrPath | Any | None, Option("FILE")]
ByTag = Annotated[str | None, Option("NAME")]


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


def keys_of(given: Mapping[str, Any] | None, what: str, example: str) -> dict[str, Any]:
    """Names and values. Raises InputError, with the example, for what is no dict."""
    if given is None or isinstance(given, Mapping):
        return dict(given or {})
    raise InputError(f"{what}: {given!r} is no dict, e.g. {example}")


def shown(path: str | os.PathLike[str]) -> str:
    """A path as it is printed: relative where it lies in the current folder."""
    here = Path.cwd()
    return str(Path(path).relative_to(here) if Path(path).is_relative_to(here) else path)
