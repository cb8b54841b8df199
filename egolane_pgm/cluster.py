"""A Dask cluster as the executor that work is shared out to.

Dask schedules, retries the work of a worker that died on another one, and takes workers that come
later. What is checked here is that a worker runs the same code as this machine, as the numbers
would not be comparable otherwise. Recordings and results lie where all machines see them.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import logging
import os
import platform
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from functools import partial
from typing import Any, TypeVar

from tqdm import tqdm

from egolane_pgm.files import code_checksum
from egolane_pgm.types import InputError

R = TypeVar("R")

#: Work that failed for a reason of the cluster's is tried again so often, by the scheduler.
_RETRIES = 2

_SECONDS_TO_ANSWER = 10


@contextlib.contextmanager
def cluster_executor(address: str) -> Iterator[Executor]:
    """The executor of a cluster.

    - address: of its scheduler, such as `tcp://host:8786`; or `local:N` for a scheduler and N
      workers on this machine, which end with the block.

    Work that a worker with other code is given fails. Raises InputError where Dask is not installed
    and where no scheduler answers or the connection to it is lost.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'egolane-pgm[cluster]'") from None
    with contextlib.ExitStack() as stack:
        place: Any = address
        if address.startswith("local:"):
            workers = LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=_number(address),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
            place = stack.enter_context(workers)
        try:
            client = stack.enter_context(
                Client(place, timeout=_SECONDS_TO_ANSWER)  # type: ignore[no-untyped-call]
            )
        except (OSError, ValueError) as error:
            raise InputError(
                f"--cluster {address}: no scheduler answers; `dask scheduler` starts one"
            ) from error
        tqdm.write(f"Dask dashboard: {client.dashboard_link}", file=sys.stderr)
        try:
            yield _Cluster(client)
        except CancelledError:
            raise InputError(f"--cluster {address}: the connection to the scheduler is lost") from (
                None
            )


def _number(address: str) -> int:
    try:
        number = int(address.removeprefix("local:"))
    except ValueError:
        number = 0
    if number < 1:
        raise InputError(f"--cluster {address}: write local:4 for four processes")
    return number


class _Cluster(Executor):
    """Dask's own executor cannot tell of work that is given up because its workers died."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        answer: Future[R] = Future()
        work = partial(fn, *args, **kwargs)
        there = self._client.submit(_do, work, code(), pure=False, retries=_RETRIES)
        there.add_done_callback(partial(_pass_on, answer))
        return answer


def _pass_on(answer: Future[R], there: Any) -> None:
    from distributed.scheduler import KilledWorker

    try:
        answer.set_result(there.result())
    except KilledWorker as error:
        answer.set_exception(BrokenExecutor(str(error)))
    except BaseException as error:
        answer.set_exception(error)


def _do(work: Callable[[], R], expected: dict[str, str]) -> R:
    found = code()
    for what, version in expected.items():
        if found[what] != version:
            raise InputError(
                f"worker {platform.node()}, process {os.getpid()}: has {what} {found[what]}, this"
                f" machine {version}; install the same on both"
            )
    return work()


@functools.cache
def code() -> dict[str, str]:
    """What the numbers depend on: the version of Python and of packages, and a checksum of this
    package's code."""
    packages = ("numpy", "scipy", "numba", "pgmpy", "opencv-python-headless")
    return {
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: importlib.metadata.version(name) for name in packages},
        "egolane_pgm code": code_checksum()[:16],
    }
