"""Progress bars of tqdm."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any

if "IPython" in sys.modules:
    with warnings.catch_warnings():
        # tqdm warns at its first import if ipywidgets is missing.
        warnings.simplefilter("ignore")
        import tqdm.auto  # noqa: F401


def bar(items: Iterable[Any] | None = None, progress: bool | None = None, **settings: Any) -> Any:
    """Make a bar of tqdm.

    - items: counted as they are taken; without items call `update`.
    - progress: whether it is shown; by default in a terminal and in a notebook.
    - settings: of tqdm.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    shown = {"disable": None if progress is None else not progress}
    if hasattr(ipython(), "kernel"):
        from tqdm.auto import tqdm as kind

        # None would hide it.
        shown = {} if progress is None else shown
    return kind(items, leave=False, **shown, **settings)


def ipython() -> Any:
    """Return the running IPython shell, or None; that of a notebook has a kernel."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
