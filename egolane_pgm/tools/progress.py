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

    - items: that it counts while they are taken; without them it is told by `update`.
    - progress: whether it is shown; None for in a terminal, and in a notebook that has ipywidgets.
      A bar of plain text would stay in the notebook.
    - settings: of tqdm.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    hidden = None if progress is None else not progress
    if "IPython" in sys.modules:
        from tqdm.autonotebook import tqdm as in_notebook

        # Without ipywidgets this is the bar of plain text.
        if in_notebook is not tqdm:
            kind, hidden = in_notebook, bool(hidden)
    return kind(items, leave=False, disable=hidden, **settings)
