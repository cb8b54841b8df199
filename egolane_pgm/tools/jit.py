"""Numba's compiler, as every kernel is given to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, njit


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles when it is first called.

    - options: numba's own, as `fastmath`.

    What was compiled is kept for the next process beside the source, or else in the user's cache
    or in `NUMBA_CACHE_DIR`. Where none of them can be written, each process compiles anew.
    With NUMBA_DISABLE_JIT the function stays plain Python, and as silent as when compiled: NumPy
    does not warn of overflows in it.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return np.errstate(all="ignore")(function)
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return decorate
