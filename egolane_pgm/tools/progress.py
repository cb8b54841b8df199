"""Progress bars of tqdm."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterable
from typing import Any


def bar(items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Make a bar of tqdm, which is shown in a terminal and in a notebook, but not by a worker.

    - items: counted as they are taken; without items call `update`.
    - settings: of tqdm.
    """
    from tqdm.auto import tqdm

    if multiprocessing.parent_process() is not None:
        settings["disable"] = True
    elif not hasattr(ipython(), "kernel"):
        # Outside of a terminal tqdm hides it.
        settings["disable"] = None
    return tqdm(items, leave=False, **settings)


def ipython() -> Any:
    """Return the running IPython shell, or None; that of a notebook has a kernel."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
