"""Work shared out to processes, through one `concurrent.futures.Executor`: a pool of this machine,
or a Dask cluster's.

Processes are started anew ("spawn", which every system has): what they are given is pickled, so
functions are named at the top of a module, and a script that shares out work does so below
`if __name__ == "__main__":`.
"""

from __future__ import annotations

import _thread
import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from tqdm import tqdm

from egolane_pgm.tools.cluster import LOCAL, GivenUp, cluster_executor
from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")

#: Processes that are told to end have this long to remove what they were writing.
_SECONDS_TO_END = 2.0

_DIED = "its process, or one beside it, died (killed, or out of memory?)"


#: Where work is shared out to: so many processes of this machine, or a Dask cluster: the address
#: of its scheduler, or `local:N` for one of N processes that is started here.
Jobs = int | str

#: More processes are a slip of the hand: they would fill the memory before one has begun to work.
MOST_PROCESSES = 1024

#: Items that are begun ahead of the one whose answer is due. It bounds the answers that wait.
_AHEAD = 256


def is_elsewhere(jobs: Jobs) -> bool:
    """Whether work is shared out to processes that may be other machines'."""
    return isinstance(jobs, str) and not jobs.startswith(LOCAL)


@contextlib.contextmanager
def executor(jobs: Jobs) -> Iterator[Executor]:
    """A pool of `jobs` processes, or the executor of a Dask cluster.

    An error inside the `with` block, Ctrl-C included, ends the pool at once: work at hand is told
    to end, work that waits is not begun. Raises InputError for a cluster that does not answer, and
    for more than MOST_PROCESSES.
    """
    if isinstance(jobs, str):
        with cluster_executor(jobs) as pool:
            yield pool
        return
    if jobs > MOST_PROCESSES:
        raise InputError(
            f"{jobs} processes are more than the {MOST_PROCESSES} that are begun; this machine has"
            f" {os.cpu_count()} cores"
        )
    others = set(multiprocessing.active_children())
    pool = _Pool(jobs)
    try:
        yield pool
    except BaseException:
        # Without waiting: what was at work may never answer.
        pool.shutdown(wait=False, cancel_futures=True)
        _end(set(multiprocessing.active_children()) - others)
        raise
    pool.shutdown()


def in_order(
    work: Callable[[T], R],
    items: Sequence[T],
    jobs: Jobs = 1,
    died: Callable[[T, str], R] | None = None,
) -> Generator[R, None, None]:
    """Yield what `work` makes of each item, in order, as soon as those before it are done.

    - work, items: picklable where there is more than one job.
    - jobs: number of processes that share the items, 1 for this process; or a cluster.
    - died: makes the answer for an item that was at work when a process died, given the reason.

    Few items are begun ahead, so that few answers wait to be taken. Raises InputError where a
    process died and `died` is None, and whatever `work` raises.
    """
    if isinstance(jobs, int) and (jobs <= 1 or len(items) <= 1):
        yield from map(work, items)
        return
    k = 0
    # The answers of items k, k + 1, ...
    answers: deque[Future[tuple[R, list[Warning]]]] = deque()
    while k < len(items):
        with executor(jobs if isinstance(jobs, str) else min(jobs, len(items) - k)) as pool:
            for j, answer in enumerate(answers):
                if not _is_done(answer):
                    answers[j] = pool.submit(_with_warnings, work, items[k + j])
            with contextlib.suppress(BrokenExecutor):
                while k < len(items):
                    for item in items[k + len(answers) : k + _AHEAD]:
                        answers.append(pool.submit(_with_warnings, work, item))
                    try:
                        made, caught = answers[0].result()
                    except GivenUp as error:
                        if died is None:
                            raise
                        made, caught = died(items[k], str(error)), []
                    for warning in caught:
                        warnings.warn(warning, stacklevel=2)
                    yield made
                    answers.popleft()
                    k += 1
        # Items are begun in order, so the first ones without an answer were at work. A cluster says
        # which one it gave up.
        at_work = jobs if isinstance(jobs, int) else 0
        for j in [j for j, answer in enumerate(answers) if not _is_done(answer)][:at_work]:
            if died is None:
                raise InputError("a process died; try again with fewer --jobs")
            answers[j] = Future()
            answers[j].set_result((died(items[k + j], _DIED), []))


def _is_done(answer: Future[Any]) -> bool:
    return (
        answer.done()
        and not answer.cancelled()
        and not isinstance(answer.exception(), BrokenExecutor | CancelledError)
    )


def _with_warnings(work: Callable[[T], R], item: T) -> tuple[R, list[Warning]]:
    with warnings.catch_warnings(record=True) as caught:
        answer = work(item)
    return answer, [w.message for w in caught if isinstance(w.message, Warning)]


class _Ended(SystemExit):
    """Raised in a process that is told to end."""


class _Pool(ProcessPoolExecutor):
    def __init__(self, n_processes: int) -> None:
        super().__init__(
            n_processes, mp_context=multiprocessing.get_context("spawn"), initializer=_begin
        )

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        # Pickled here, so that what cannot be pickled is an error of the caller's.
        given = pickle.dumps((fn, args, kwargs))
        with _without_interrupts():
            return super().submit(_do, given)


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Processes that are started here leave Ctrl-C to this one, from their first moment on. Where
    a system has no such thing they do so once they have begun."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """What a process does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _raise_ended)
    sys.unraisablehook = _print_ignored
    # The lock that progress bars share by default is the system's: a process that is ended would
    # leave it behind, and Python warns of that.
    tqdm.set_lock(threading.RLock())
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _raise_ended(*_: Any) -> None:
    # Once: both this package and the pool may tell a process to end, which cleans up meanwhile.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise _Ended(1)


def _print_ignored(ignored: sys.UnraisableHookArgs) -> None:
    """Python ignores what is raised while an object is removed. A process that went on because of
    that is killed a moment later."""
    if not issubclass(ignored.exc_type, _Ended):
        sys.__unraisablehook__(ignored)


def _end_with_parent() -> None:
    """A process would wait for ever for work of a parent that was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    _thread.interrupt_main(signal.SIGTERM)
    time.sleep(_SECONDS_TO_END)
    os._exit(1)


def _do(given: bytes) -> Any:
    try:
        work, args, kwargs = pickle.loads(given)
        return work(*args, **kwargs)
    except _Ended:
        # The work has cleaned up behind itself; the pool would go on with its next item.
        sys.stdout.flush()
        os._exit(1)


def _end(processes: set[BaseProcess]) -> None:
    for process in processes:
        process.terminate()
    until = time.monotonic() + _SECONDS_TO_END
    for process in processes:
        process.join(max(0.0, until - time.monotonic()))
        process.kill()
