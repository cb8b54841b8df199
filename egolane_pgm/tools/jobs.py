"""Work shared by processes: joblib's on this machine, or those of a Dask cluster.

The work and its items are pickled. All machines of a cluster need access to the recordings and
results under the same paths, and the same version of this package.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from tqdm import tqdm

from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

T = TypeVar("T")
R = TypeVar("R")


def parallel(
    work: Callable[[T], R], items: Sequence[T], *, jobs: int = 1, cluster: str | None = None
) -> Iterator[R]:
    """Yield the results of `work` for each item, in order.

    - jobs: number of processes; 1 for this one.
    - cluster: the address of a Dask scheduler instead, which repeats the work of a worker that
      died.

    Raises InputError if a process dies.
    """
    if cluster is None and (jobs <= 1 or len(items) <= 1):
        yield from map(work, items)
        return
    # joblib is slow to import.
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with contextlib.ExitStack() as stack:
        if cluster is None:
            jobs = min(jobs, len(items))
            stack.enter_context(parallel_config("loky", n_jobs=jobs, initializer=_begin))
        else:
            stack.enter_context(_client(cluster))
            stack.enter_context(parallel_config("dask", n_jobs=-1))
        try:
            yield from Parallel(return_as="generator", batch_size=1)(
                delayed(work)(item) for item in items
            )
        except KeyboardInterrupt:
            if cluster is None:
                get_reusable_executor().shutdown(kill_workers=True)
            raise
        except TerminatedWorkerError as error:
            raise InputError(
                "a process died (killed, or out of memory?); repeat the command, with fewer"
                " processes"
            ) from error


def _begin() -> None:
    """Prepare a process."""
    # The command handles Ctrl-C and ends its processes.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The default lock is a semaphore, and Python warns of it if a process is killed.
    tqdm.set_lock(threading.RLock())
    threading.Thread(target=_end_with, args=[os.getppid()], daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process soon after its parent has ended, whatever ended that."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


@contextlib.contextmanager
def _client(address: str) -> Iterator[Any]:
    """Connect to a Dask cluster."""
    with needed("a cluster", "cluster"):
        from distributed import Client
        from distributed.utils import silence_logging_cmgr
    # Dask logs a traceback for each lost worker.
    with silence_logging_cmgr(logging.CRITICAL), contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, timeout=10))  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            raise InputError(
                f"cluster {address}: no scheduler answers; `dask scheduler` starts one"
            ) from error
        print(f"Dask dashboard: {client.dashboard_link}", file=sys.stderr)
        yield client
