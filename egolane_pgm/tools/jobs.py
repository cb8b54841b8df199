"""Work shared out to processes: joblib's (loky) on this machine, or those of a Dask cluster.

What is shared out is pickled. On a cluster recordings and results lie where all machines see them.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import logging
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent import futures
from functools import partial
from typing import Any, TypeVar

from tqdm import tqdm

from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")

#: A number of processes of this machine, or a Dask cluster: the address of its scheduler, or
#: `local:N` for one of N processes that is started here.
Jobs = int | str

_LOCAL = "local:"

_DIED = "its process, or one beside it, died (killed, or out of memory?)"


def in_order(
    work: Callable[[T], R],
    items: Sequence[T],
    jobs: Jobs = 1,
    died: Callable[[T, str], R] | None = None,
    *,
    ordered: bool = True,
) -> Generator[R, None, None]:
    """Yield what `work` makes of each item, in order, as soon as those before it are done.

    - jobs: number of processes that share the items, 1 for this process; or a cluster.
    - died: makes the answer for an item that was at work when a process died, given the reason.
    - ordered: False for the answers as they are done.

    Raises what `work` raises, and InputError where a process died and `died` is None.
    """
    if isinstance(jobs, int) and (jobs <= 1 or len(items) <= 1):
        yield from map(work, items)
        return
    left = dict(enumerate(items))
    # A pool of joblib's ends with a process of it: another one does what is left.
    while left:
        with _pool(jobs, len(left)) as (submit, as_completed, killed):
            number = {submit(work, item): k for k, item in left.items()}
            for future in number if ordered else as_completed(number):
                item = left.pop(number[future])
                try:
                    yield future.result()
                except killed as error:
                    if died is None:
                        raise InputError(f"{_DIED}; try again with fewer processes") from error
                    yield died(item, _DIED)
                    if killed is futures.BrokenExecutor:
                        break


@contextlib.contextmanager
def _pool(jobs: Jobs, n_items: int) -> Iterator[tuple[Callable[..., Any], Any, Any]]:
    """What submits work, what yields futures as they are done, and what they raise where a process
    died. An error inside the block, Ctrl-C included, ends the processes of this machine at once."""
    if isinstance(jobs, str):
        with _client(jobs) as client:
            from distributed import as_completed
            from distributed.scheduler import KilledWorker

            do = partial(client.submit, _do, code(), os.getcwd(), pure=False)
            yield do, as_completed, KilledWorker
        return
    from joblib.externals.loky import ProcessPoolExecutor

    pool = ProcessPoolExecutor(
        min(jobs, n_items),
        # A process whose parent was killed ends once it has nothing to do.
        timeout=300,
        initializer=_begin,
        env=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
    )
    try:
        yield pool.submit, futures.as_completed, futures.BrokenExecutor
    finally:
        pool.shutdown(kill_workers=True)


def _begin() -> None:
    """What a process does first."""
    # Ctrl-C is the command's, which ends its processes.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Bars share a lock of the system's by default, of which Python warns where a process is killed.
    tqdm.set_lock(threading.RLock())


@contextlib.contextmanager
def _client(address: str) -> Iterator[Any]:
    """Dask's client of a cluster. Dask does the work of a worker that died on another one, and
    takes workers that come later."""
    with needed("a cluster", "cluster"):
        from distributed import Client, LocalCluster
        from distributed.utils import silence_logging_cmgr
    # Dask logs each worker and scheduler that it loses, with a traceback.
    with silence_logging_cmgr(logging.CRITICAL), contextlib.ExitStack() as stack:
        place: Any = address
        try:
            if address.startswith(_LOCAL):
                # 0 or less is 1: a cluster without workers would be waited for.
                place = LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=max(1, int(address.removeprefix(_LOCAL))),
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
                stack.enter_context(place)
            known = Client(place, timeout=10)  # type: ignore[no-untyped-call]
            client = stack.enter_context(known)
        except (OSError, ValueError) as error:
            raise InputError(
                f"cluster {address}: no scheduler answers; `dask scheduler` starts one, local:4"
                " is one of four processes on this machine"
            ) from error
        tqdm.write(f"Dask dashboard: {client.dashboard_link}", file=sys.stderr)
        try:
            yield client
        except futures.CancelledError:
            said = f"cluster {address}: the connection to the scheduler is lost"
            raise InputError(said) from None


def _do(expected: dict[str, str], folder: str, work: Callable[..., R], /, *given: Any) -> R:
    """Do work in a worker, in the folder of the command, where its numbers would be the same."""
    from distributed import get_worker

    worker = f"worker {platform.node()}, process {os.getpid()}"
    for what, version in expected.items():
        if code()[what] != version:
            raise InputError(
                f"{worker}: has {what} {code()[what]}, this machine {version}; install the same on"
                " both"
            )
    if get_worker().state.nthreads > 1:
        # Threads have one folder together.
        raise InputError(f"{worker}: has threads; start it with one, once per processor")
    os.chdir(folder)
    return work(*given)


@functools.cache
def code() -> dict[str, str]:
    """What the numbers depend on: the version of Python and of packages."""
    packages = ("egolane-pgm", "numpy", "scipy", "numba", "pgmpy", "opencv-python-headless")
    return {
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: importlib.metadata.version(name) for name in packages},
    }
