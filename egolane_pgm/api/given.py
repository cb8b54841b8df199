"""What the verbs are given: experiments, and whether they show how far they are."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from egolane_pgm.experiment import Experiment
from egolane_pgm.types import InputError

if "IPython" in sys.modules:
    with warnings.catch_warnings():
        # Without ipywidgets tqdm asks for them when it is imported first, by Optuna if not here.
        warnings.simplefilter("ignore")
        import tqdm.auto  # noqa: F401


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


def bar(items: Iterable[Any] | None, progress: bool | None, **settings: Any) -> Any:
    """A bar of tqdm that says how far something is.

    - progress: whether it is shown; None for in a terminal, and in a notebook that has ipywidgets.
      A bar of plain text would stay in the notebook.
    """
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    if "IPython" in sys.modules:
        from tqdm.autonotebook import tqdm as in_notebook

        # Without ipywidgets this is the bar of plain text.
        if in_notebook is not tqdm:
            return in_notebook(items, leave=False, disable=bool(hidden), **settings)
    return tqdm(items, leave=False, disable=hidden, **settings)
