"""How far something is, as a bar of tqdm."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any

if "IPython" in sys.modules:
    with warnings.catch_warnings():
        # Without ipywidgets tqdm asks for them when it is imported first, by Optuna if not here.
        warnings.simplefilter("ignore")
        import tqdm.auto  # noqa: F401


def bar(items: Iterable[Any] | None = None, progress: bool | None = None, **settings: Any) -> Any:
    """A bar of tqdm.

    - items: that it counts while they are taken; without them it counts by `update`.
    - progress: whether it is shown; None for in a terminal, and in a notebook.
    - settings: of tqdm.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    shown = {"disable": None if progress is None else not progress}
    if hasattr(ipython(), "kernel"):
        from tqdm.auto import tqdm as kind

        # None would hide it, as everywhere but in a terminal.
        shown = {} if progress is None else shown
    return kind(items, leave=False, **shown, **settings)


def ipython() -> Any:
    """The shell of IPython that runs this, or None; a notebook's has a kernel."""
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
