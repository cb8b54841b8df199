"""What the verbs are given: experiments, and names of files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.experiment import Experiment
from egolane_pgm.types import InputError


def several_of(given: Any, what: str) -> list[Any]:
    """One or several things as a list."""
    if given is None:
        return []
    if isinstance(given, (str, os.PathLike, Experiment, Mapping)):
        return [given]
    if isinstance(given, Sequence):
        return list(given)
    raise InputError(f"{what}: {given!r} is neither one nor a list of several")


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
