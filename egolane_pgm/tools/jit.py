"""Compile kernels with numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, njit

from egolane_pgm.types import FloatArray


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


@kernel(inline="always")
def sort_first(values: FloatArray, n: int) -> None:
    """Sort the first n values, which are few; numba takes two seconds to compile `np.sort`."""
    for i in range(1, n):
        value = values[i]
        at = i
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
