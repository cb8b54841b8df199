"""What the verbs are given: experiments, and whether they show how far they are."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
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
    raise InputError(f"{what}: a {type(given).__name__} is neither one nor a list of several")


def bar(items: Iterable[Any] | None, progress: bool | None, **settings: Any) -> Any:
    """A bar of tqdm that says how far something is.

    - progress: whether it is shown; None for in a terminal, and in a notebook that has ipywidgets.
      A bar of plain text would stay in the notebook.
    """
    from tqdm import tqdm

    hidden = None if progress is None else not progress
    if "IPython" in sys.modules:
        with warnings.catch_warnings():
            # Without ipywidgets tqdm asks for them, and draws plain text.
            warnings.simplefilter("ignore")
            from tqdm.autonotebook import tqdm as in_notebook
        if in_notebook is not tqdm:
            return in_notebook(items, leave=False, disable=bool(hidden), **settings)
    return tqdm(items, leave=False, disable=hidden, **settings)
