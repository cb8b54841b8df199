"""Compile kernels with numba."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from multiprocessing import parent_process
from typing import Any

import numpy as np
from numba import config, njit
from numba.core.event import Event, Listener, register


class _Compilations(Listener):
    """Announce the first kernel that is compiled instead of loaded from the cache."""

    def on_start(self, event: Event) -> None:
        if event.data["dispatcher"].py_func.__module__.startswith("egolane_pgm."):
            _announce()

    def on_end(self, event: Event) -> None:
        pass


@cache
def _announce() -> None:
    """Print a line on standard error, once per process.

    Workers do not print it, nor do programs that redirect `sys.stderr`, such as notebooks.
    """
    if parent_process() is None and sys.stderr is sys.__stderr__:
        print("compiling the kernels once, which takes some seconds", file=sys.stderr)


register("numba:compile", _Compilations())  # type: ignore[no-untyped-call]


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
