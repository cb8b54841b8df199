"""Progress bars of tqdm."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any


def bar(items: Iterable[Any] | None = None, progress: bool | None = None, **settings: Any) -> Any:
    """Make a bar of tqdm.

    - items: counted as they are taken; without items call `update`.
    - progress: whether it is shown; by default in a terminal and in a notebook.
    - settings: of tqdm.
    """
    with warnings.catch_warnings():
        # tqdm warns at its first import if ipywidgets is missing.
        warnings.simplefilter("ignore")
        from tqdm.auto import tqdm
    # With None tqdm shows it in a terminal only.
    by_default = False if hasattr(ipython(), "kernel") else None
    disable = by_default if progress is None else not progress
    return tqdm(items, leave=False, disable=disable, **settings)


def ipython() -> Any:
    """Return the running IPython shell, or None; that of a notebook has a kernel."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
