from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from egolane_pgm.tools import jobs as module
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.types import InputError


def ten_times(k: int) -> int:
    return 10 * k


def first_is_slow(k: int) -> int:
    time.sleep(0.5 if k == 0 else 0)
    return k


def leave_a_file(folder: Path, k: int) -> int:
    (folder / str(k)).touch()
    time.sleep(0.2)
    return k


def die_at(number: int, k: int) -> str:
    if k == number:
        os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
    time.sleep(0.2)
    return str(k)


def given_up(k: int, why: str) -> str:
    return f"{k} {why.split()[-1]}"


def refuse_three(k: int) -> int:
    if k == 3:
        raise InputError("three")
    return k


def where(_: int) -> str:
    return os.getcwd()


@pytest.fixture(scope="module")
def dask() -> Iterator[str]:
    """The address of a cluster of two workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["one process", "two processes", "Dask"])
def jobs(request: pytest.FixtureRequest) -> Jobs:
    if request.param == "Dask":
        return str(request.getfixturevalue("dask"))
    return 1 if request.param == "one process" else 2


def test_answers_come_in_order_or_as_they_are_done(jobs: Jobs) -> None:
    assert list(in_order(ten_times, range(7), jobs)) == [0, 10, 20, 30, 40, 50, 60]
    assert list(in_order(first_is_slow, range(4), jobs)) == [0, 1, 2, 3]
    found = list(in_order(first_is_slow, range(4), jobs, ordered=False))
    assert sorted(found) == [0, 1, 2, 3]
    assert (found[0] == 0) == (jobs == 1)


def test_an_error_of_the_work_is_raised_in_its_turn(jobs: Jobs) -> None:
    answers = in_order(refuse_three, range(6), jobs)
    assert [next(answers) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match="three"):
        next(answers)


def test_nothing_is_begun_after_the_work_is_left(jobs: Jobs, tmp_path: Path) -> None:
    answers = in_order(partial(leave_a_file, tmp_path), range(60), jobs)
    assert next(answers) == 0
    answers.close()
    # A worker of Dask's begins what it was given before it hears.
    time.sleep(1)
    begun = len(list(tmp_path.iterdir()))
    assert begun < 30
    time.sleep(1)
    assert len(list(tmp_path.iterdir())) == begun


def test_a_process_that_dies_costs_one_answer_and_nothing_else() -> None:
    answers = list(in_order(partial(die_at, 5), range(12), 2, died=given_up))
    lost = [k for k, answer in enumerate(answers) if answer != str(k)]
    # The one beside it may be named before it.
    assert 5 in lost
    assert set(lost) <= {4, 5}
    assert answers[5] == "5 memory?)"
    with pytest.raises(InputError, match=r"died .*; try again with fewer processes"):
        list(in_order(partial(die_at, 0), range(3), 2))


def test_a_worker_with_other_code_is_refused(dask: str, monkeypatch: pytest.MonkeyPatch) -> None:
    here = module.code()
    monkeypatch.setattr(module, "code", lambda: {**here, "numpy": "1.0"})
    with pytest.raises(InputError, match=r"has numpy .*, this machine 1.0; install the same"):
        list(in_order(ten_times, range(2), dask))


def test_relative_names_mean_on_a_worker_what_they_mean_here(
    dask: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert list(in_order(where, range(2), dask)) == [str(tmp_path)] * 2


@pytest.mark.parametrize("address", ["nowhere", "local:none"])
def test_a_cluster_that_is_not_there_is_refused_in_one_line(address: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match=f"cluster {address}: no scheduler answers"):
        list(in_order(ten_times, range(2), address))
