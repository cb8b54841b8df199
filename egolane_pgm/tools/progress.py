"""How far something is, as a bar of tqdm."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any


def bar(items: Iterable[Any] | None = None, progress: bool | None = None, **settings: Any) -> Any:
    """A bar of tqdm.

    - items: counted while they are taken; without them call `update`.
    - progress: whether it is shown; None for in a terminal, and in a notebook.
    - settings: of tqdm.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    shown = {"disable": None if progress is None else not progress}
    if "ipykernel" in sys.modules:
        with warnings.catch_warnings():
            # Without ipywidgets it is a bar of plain text, and tqdm asks for them.
            warnings.simplefilter("ignore")
            from tqdm.auto import tqdm as kind
        # None would hide it, as everywhere but in a terminal.
        shown = {} if progress is None else shown
    return kind(items, leave=False, **shown, **settings)
