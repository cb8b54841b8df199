"""Work that processes share."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")

#: In a forked process: what it works with; whether it is at work; whether it was interrupted.
_inherited: list[Any] = []
_state = {"is_busy": False, "is_interrupted": False}

_DIED = "its process died, and again when it was tried alone (killed, or out of memory?)"


def _inherit(work: Callable[[Any], Any], items: Sequence[Any], parent: int) -> None:
    _inherited[:] = [work, items]
    signal.signal(signal.SIGINT, _interrupt)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _interrupt(*_: Any) -> None:
    """Ctrl-C ends the work at hand, once: the terminal and the parent may both send it."""
    is_first = not _state["is_interrupted"]
    _state["is_interrupted"] = True
    if is_first and _state["is_busy"]:
        raise KeyboardInterrupt


def _end_with(parent: int) -> None:
    """Ends this process, which would wait for ever, when its parent was killed."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGINT)
    while _state["is_busy"]:
        time.sleep(0.1)
    os._exit(1)


def _do(k: int) -> Any:
    work, items = _inherited
    _state["is_busy"] = True
    try:
        # What was queued before the interruption is not begun after it.
        if _state["is_interrupted"]:
            raise KeyboardInterrupt
        return work(items[k])
    finally:
        _state["is_busy"] = False


def in_processes(
    work: Callable[[T], R],
    items: Sequence[T],
    jobs: int,
    died: Callable[[T, str], R] | None = None,
) -> Iterator[R]:
    """What `work` makes of each item, in order.

    An item whose process died, or one beside it (which one did cannot be told), is tried again
    alone. died: what stands for one that dies again, given the reason; without it InputError is
    raised. Items that are not begun when it is left are not done, those at hand are interrupted.
    """
    if jobs <= 1 or len(items) <= 1 or "fork" not in multiprocessing.get_all_start_methods():
        yield from map(work, items)
        return
    known: dict[int, R] = {}
    k = 0
    while k < len(items):
        if k in known:
            yield known.pop(k)
            k += 1
            continue
        todo = [j for j in range(k, len(items)) if j not in known]
        waiting: dict[int, Future[R]] = {}
        with _pool(work, items, min(jobs, len(todo))) as pool:
            try:
                for j in todo:
                    waiting[j] = pool.submit(_do, j)
                while k < len(items):
                    yield known.pop(k) if k in known else waiting[k].result()
                    k += 1
            except BrokenProcessPool:
                known |= {
                    j: waiting[j].result() for j in waiting if j >= k and _is_good(waiting[j])
                }
        # They are begun in order.
        for j in [j for j in todo if j >= k and j not in known][:jobs]:
            known[j] = _alone(work, items, j, died)


def _is_good(answer: Future[Any]) -> bool:
    return answer.done() and not answer.cancelled() and answer.exception() is None


def _alone(
    work: Callable[[T], R], items: Sequence[T], k: int, died: Callable[[T, str], R] | None
) -> R:
    with _pool(work, items, 1) as pool:
        try:
            answer: R = pool.submit(_do, k).result()
            return answer
        except BrokenProcessPool as error:
            if died is None:
                raise InputError("a process died; try again with fewer --jobs") from error
            return died(items[k], _DIED)


@contextlib.contextmanager
def _pool(
    work: Callable[[Any], Any], items: Sequence[Any], n_processes: int
) -> Iterator[ProcessPoolExecutor]:
    """Forked processes inherit work and items. Sent through the pool's queue they would have to be
    pickled, and after one that cannot be Python 3.11's pool never ends: its manager thread still
    waits for the answer when `shutdown` waits for the thread."""
    context = multiprocessing.get_context("fork")
    given = (work, items, os.getpid())
    with ProcessPoolExecutor(
        n_processes, mp_context=context, initializer=_inherit, initargs=given
    ) as pool:
        try:
            yield pool
        except BaseException:
            # After Ctrl-C or an error nobody asks for the rest; after a second one not even for
            # an end in good order.
            with _second_kills():
                for process in multiprocessing.active_children():
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(process.pid or 0, signal.SIGINT)
                pool.shutdown(cancel_futures=True)
            raise


@contextlib.contextmanager
def _second_kills() -> Iterator[None]:
    """Meanwhile Ctrl-C kills the processes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def kill(*_: Any) -> None:
        for process in multiprocessing.active_children():
            process.kill()

    before = signal.signal(signal.SIGINT, kill)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
