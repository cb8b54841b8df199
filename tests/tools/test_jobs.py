"""Work shared by processes: the same answers, and nothing is left behind."""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from egolane_pgm.tools.jobs import parallel
from egolane_pgm.types import InputError


def ten_times(k: int) -> int:
    return 10 * k


def first_is_slow(k: int) -> int:
    time.sleep(0.5 if k == 0 else 0)
    return k


def die_at(number: int, k: int) -> str:
    if k == number:
        os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
    time.sleep(0.2)
    return str(k)


def refuse_three(k: int) -> int:
    if k == 3:
        raise InputError("three")
    return k


@pytest.fixture(scope="module")
def dask() -> Iterator[str]:
    """The address of a cluster of two workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["one process", "two processes", "Dask"])
def way(request: pytest.FixtureRequest) -> dict[str, Any]:
    if request.param == "Dask":
        return {"cluster": request.getfixturevalue("dask")}
    return {"jobs": 1 if request.param == "one process" else 2}


def test_answers_come_in_order(way: dict[str, Any]) -> None:
    assert list(parallel(ten_times, range(7), **way)) == [0, 10, 20, 30, 40, 50, 60]
    assert list(parallel(first_is_slow, range(4), **way)) == [0, 1, 2, 3]


def test_an_error_of_the_work_is_raised(way: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="three"):
        list(parallel(refuse_three, range(6), **way))


def test_a_process_that_dies_is_one_line() -> None:
    with pytest.raises(InputError, match=r"a process died .*; repeat the command"):
        list(parallel(partial(die_at, 5), range(12), jobs=2))


@pytest.mark.parametrize("address", ["nowhere", "tcp://127.0.0.1:1"])
def test_a_cluster_that_is_not_there_is_refused_in_one_line(address: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match=f"cluster {address}: no scheduler answers"):
        list(parallel(ten_times, range(2), cluster=address))
    # A refused client that is collected while the next one starts its loop would block it.
    gc.collect()
