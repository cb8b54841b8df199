"""Compile kernels with numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, njit


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles at its first call.

    - options: of numba, e.g. `fastmath`.

    Compiled code is cached next to the source, in the user's cache or in `NUMBA_CACHE_DIR`; if
    none is writable, each process compiles. With NUMBA_DISABLE_JIT the function stays plain Python,
    without NumPy's warnings of overflows, as when compiled.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return np.errstate(all="ignore")(function)
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return decorate
