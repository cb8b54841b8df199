"""Work that processes share."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")

_DIED = "its process, or one beside it, died; try again with fewer --jobs"


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
    with ProcessPoolExecutor(min(jobs, len(items)), mp_context=context) as pool:
        waiting = [pool.submit(work, item) for item in items]
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
