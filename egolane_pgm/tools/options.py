"""Types of the parameters of verbs, with their look on the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge

StrPath = str | os.PathLike[str]

#: Lines of a drive: a file, a LineLog or a DataFrame.
Lines = StrPath | Any
#: The annotated lanes of a drive: a file or a DataFrame; "none" for none.
Truth = StrPath | Any


@dataclass(frozen=True)
class Option:
    """The look of a verb's parameter on the command line, beyond its name and type.

    - metavar: placeholder of the value in the help.
    - names: further names, "-o", or another long one in place of the parameter's.
    - default: default of the command, if it differs from the function's.
    - envvar: environment variable that gives it.
    - required: whether a command needs it.
    - in_python: whether the command does without it.
    """

    metavar: str | None = None
    names: tuple[str, ...] = ()
    default: Any = None
    envvar: str | None = None
    required: bool = False
    in_python: bool = False


#: Of lines in memory the ground truth (a list for several drives) and the number of lanes.
TruthInMemory = Annotated[Any, Option(in_python=True)]
LanesInMemory = Annotated[int | None, Option(in_python=True)]
#: A file that the command writes.
Target = Annotated[StrPath | None, Option("FILE", names=("-o",), required=True)]
#: Number of folds; 0 for none.
Folds = Annotated[int | None, Ge(0)]
Jobs = Annotated[int, Ge(1)]
#: A Dask cluster; see `tools.jobs`.
Cluster = Annotated[str | None, Option("ADDRESS")]
Graph = Annotated[Any, Option("NAME|FILE")]
#: Columns of a table, or fields of messages; see `recordings.columns`.
ColumnNames = Annotated[str | Sequence[str] | Mapping[str, Any] | None, Option("OURS=THEIRS,...")]
TableOfRuns = Annotated[StrPath | Any | None, Option("FILE")]
ByTag = Annotated[str | None, Option("NAME")]
Overrides = Annotated[
    Mapping[str, Any] | Sequence[str] | None, Option("KEY=VALUE", names=("--set",))
]


def several_of(given: Any) -> list[Any]:
    """One or several things as a list."""
    if given is None:
        return []
    return list(given) if isinstance(given, (list, tuple)) else [given]


def place_of(out: StrPath | None, name: str) -> Path | None:
    """The directory for a result; `*` is replaced with the name. None without `out`."""
    return None if out is None else Path(os.fspath(out).replace("*", name))
