"""Numba's compiler, as every kernel is given to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles when it is first called.

    - options: numba's own, as `fastmath`.

    What was compiled is kept for the next process beside the source, or else in the user's cache
    or in `NUMBA_CACHE_DIR`. Where none of them can be written, each process compiles anew.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return decorate
