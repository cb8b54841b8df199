"""A Dask cluster as the executor that work is shared out to.

Dask schedules, retries the work of a worker that died on another one, and takes workers that come
later. What is checked here is that a worker runs the same code as this machine, as the numbers
would not be comparable otherwise. Recordings and results lie where all machines see them.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import importlib.metadata
import logging
import os
import platform
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from functools import partial
from importlib.resources import files
from typing import Any, TypeVar

from tqdm import tqdm

from egolane_pgm.tools.files import code_checksum
from egolane_pgm.types import InputError

R = TypeVar("R")

#: Work that failed for a reason of the cluster's is tried again so often, by the scheduler.
_RETRIES = 2

_SECONDS_TO_ANSWER = 10

#: What the address of a cluster of this machine begins with.
LOCAL = "local:"


@contextlib.contextmanager
def cluster_executor(address: str) -> Iterator[Executor]:
    """The executor of a cluster.

    - address: of its scheduler, such as `tcp://host:8786`; or `local:N` for a scheduler and N
      workers on this machine, which end with the block.

    Work that a worker with other code is given fails. Raises InputError where Dask is not
    installed, where no scheduler answers or the connection to it is lost, and where this package
    is not installed on the cluster.
    """
    try:
        from distributed import Client, LocalCluster
        from distributed.utils import silence_logging_cmgr
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'egolane-pgm[cluster]'") from None
    with contextlib.ExitStack() as stack:
        # Dask logs each worker and scheduler that it loses, with a traceback.
        stack.enter_context(silence_logging_cmgr(logging.CRITICAL))
        place: Any = address
        if address.startswith(LOCAL):
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
        _check_installed(client, address)
        try:
            yield _Cluster(client)
        except CancelledError:
            raise InputError(f"--cluster {address}: the connection to the scheduler is lost") from (
                None
            )


def _number(address: str) -> int:
    try:
        number = int(address.removeprefix(LOCAL))
    except ValueError:
        number = 0
    if number < 1:
        raise InputError(f"--cluster {address}: write local:4 for four processes")
    return number


def _check_installed(client: Any, address: str) -> None:
    """A scheduler without this package hands out no work, and a worker without it ends."""
    package = "egolane_pgm"
    found = client.run(files, package, on_error="return")
    if not found:
        late = f"--cluster {address}: has no worker yet; `dask worker {address}` starts one"
        tqdm.write(late, file=sys.stderr)
    try:
        client.run_on_scheduler(files, package)
    except ModuleNotFoundError as error:
        found["the scheduler"] = error
    for where, answer in found.items():
        if isinstance(answer, ModuleNotFoundError):
            raise InputError(f"--cluster {address}: {where} cannot import {package}: {answer}")


class GivenUp(InputError):
    """Raised by the answer of work whose workers died, one after the other."""


class _Cluster(Executor):
    """Dask's own executor takes a result whose worker dies at that moment for an error."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        work = partial(fn, *args, **kwargs)
        there = self._client.submit(_do, work, code(), os.getcwd(), pure=False, retries=_RETRIES)
        return asyncio.run_coroutine_threadsafe(_answer(there), self._client.loop.asyncio_loop)


async def _answer(there: Any) -> Any:
    """What became of work on a cluster; Dask repeats work whose result is lost with its worker."""
    from distributed.scheduler import KilledWorker

    try:
        return await there
    except KilledWorker as error:
        n_died = error.allowed_failures + 1
        raise GivenUp(f"{n_died} worker(s) died at this work (killed, or out of memory?)") from None
    except OSError:
        if there.status == "error":
            raise
        # Not the work's: the scheduler went away while it handed out the result.
        raise CancelledError from None


def _do(work: Callable[[], R], expected: dict[str, str], folder: str) -> R:
    """Do work in a worker, which stands in the folder of the command for it."""
    from distributed import get_worker

    worker = f"worker {platform.node()}, process {os.getpid()}"
    found = code()
    for what, version in expected.items():
        if found[what] != version:
            raise InputError(
                f"{worker}: has {what} {found[what]}, this machine {version}; install the same on"
                " both"
            )
    if get_worker().state.nthreads > 1:
        # Threads share their folder, and hear each other's warnings.
        raise InputError(f"{worker}: has threads; start it with `--nthreads 1`, once per processor")
    try:
        os.chdir(folder)
    except OSError as error:
        raise InputError(f"{worker}: has no folder {folder} ({error.strerror})") from None
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
