"""Progress bars of tqdm."""

from __future__ import annotations

import multiprocessing
import sys
import warnings
from collections.abc import Iterable
from typing import Any

if "IPython" in sys.modules:
    with warnings.catch_warnings():
        # tqdm warns at its first import if ipywidgets is missing.
        warnings.simplefilter("ignore")
        import tqdm.auto  # noqa: F401


def bar(items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Make a bar of tqdm, which is shown in a terminal and in a notebook, but not by a worker.

    - items: counted as they are taken; without items call `update`.
    - settings: of tqdm.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    # With None tqdm hides it outside of a terminal.
    is_hidden = True if multiprocessing.parent_process() else None
    if hasattr(ipython(), "kernel"):
        from tqdm.auto import tqdm as kind

        is_hidden = False
    return kind(items, leave=False, disable=is_hidden, **settings)


def ipython() -> Any:
    """Return the running IPython shell, or None; that of a notebook has a kernel."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
