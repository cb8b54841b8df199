"""Work that processes share."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")

#: In a forked process: what it works with.
_inherited: list[Any] = []

_DIED = "its process, or one beside it, died; try again with fewer --jobs"


def _inherit(work: Callable[[Any], Any], items: Sequence[Any]) -> None:
    _inherited[:] = [work, items]


def _do(k: int) -> Any:
    work, items = _inherited
    return work(items[k])


def in_processes(
    work: Callable[[T], R],
    items: Sequence[T],
    jobs: int,
    died: Callable[[T, str], R] | None = None,
) -> Iterator[R]:
    """What `work` makes of each item, in order.

    died: what stands for an item whose process died (which one did cannot be told), given the
    reason; without it InputError is raised. Items that are not begun when it is left are not done.
    """
    if jobs <= 1 or len(items) <= 1 or "fork" not in multiprocessing.get_all_start_methods():
        yield from map(work, items)
        return
    context = multiprocessing.get_context("fork")
    # Forked processes inherit work and items. Sent through the pool's queue they would have to be
    # pickled, and after one that cannot be Python 3.11's pool never ends: its manager thread still
    # waits for the answer when `shutdown` waits for the thread.
    with ProcessPoolExecutor(
        min(jobs, len(items)), mp_context=context, initializer=_inherit, initargs=(work, items)
    ) as pool:
        waiting = [pool.submit(_do, k) for k in range(len(items))]
        try:
            for item, future in zip(items, waiting, strict=True):
                try:
                    yield future.result()
                except BrokenProcessPool as error:
                    if died is None:
                        raise InputError("a process died; try again with fewer --jobs") from error
                    yield died(item, _DIED)
        finally:
            # After Ctrl-C or an error nobody asks for the rest.
            pool.shutdown(cancel_futures=True)
