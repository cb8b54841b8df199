from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from egolane_pgm.tools import cluster
from egolane_pgm.tools.jobs import executor, in_order
from egolane_pgm.types import InputError
from tests import cluster_demo
from tests.cluster_demo import cluster as started_cluster
from tests.cluster_demo import start_worker

pytest.importorskip("distributed")


def ten_times(k: int) -> int:
    return 10 * k


def die_at_zero(k: int) -> str:
    if k == 0:
        die()
    return str(k)


def die() -> None:
    os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)


def given_up(k: int, why: str) -> str:
    return f"{k}: {why.partition(' (')[0]}"


def refuse_two(k: int) -> int:
    if k == 2:
        raise InputError("two")
    return k


class Deadly:
    """Kills the first process that is asked for it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable[[str], str], tuple[str]]:
        if not (self.folder / "killed").exists():
            (self.folder / "killed").touch()
            die()
        return str, ("survived",)


def deadly_at_one(folder: Path, k: int) -> object:
    (folder / f"made {k} {os.getpid()}").touch()
    return Deadly(folder) if k == 1 else str(k)


def begin_slowly(folder: Path, k: int) -> int:
    (folder / f"begun {k}").touch()
    time.sleep(0.3)
    return k


def where(_: int) -> str:
    return os.getcwd()


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with started_cluster(2, tmp_path_factory.mktemp("cluster")) as (address, _, _):
        yield address


def test_a_summary_is_the_same_though_a_worker_is_killed_and_one_is_added() -> None:
    assert cluster_demo.main(drives=12, frames=60, n_workers=2)


def test_an_error_of_the_work_is_raised_in_its_turn_and_other_code_is_refused(
    two_workers: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = in_order(refuse_two, range(4), two_workers)
    assert [next(answers), next(answers)] == [0, 1]
    with pytest.raises(InputError, match="two"):
        next(answers)
    here = cluster.code()
    monkeypatch.setattr(cluster, "code", lambda: {**here, "numpy": "1.0"})
    with pytest.raises(InputError, match=r"has numpy .*, this machine 1.0; install the same"):
        list(in_order(ten_times, range(2), two_workers))


def test_relative_names_mean_on_a_worker_what_they_mean_here(
    two_workers: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert list(in_order(where, range(2), two_workers)) == [str(tmp_path)] * 2
    monkeypatch.setattr(os, "getcwd", lambda: "/not/there")
    with pytest.raises(InputError, match="has no folder /not/there"):
        list(in_order(where, range(2), two_workers))


def test_two_commands_share_a_cluster(two_workers: str) -> None:
    one = in_order(ten_times, range(20), two_workers)
    two = in_order(refuse_two, range(3, 23), two_workers)
    assert list(zip(one, two, strict=True)) == [(10 * k, k + 3) for k in range(20)]


def test_nothing_is_begun_after_the_work_is_left(two_workers: str, tmp_path: Path) -> None:
    answers = in_order(partial(begin_slowly, tmp_path), range(60), two_workers)
    assert next(answers) == 0
    answers.close()
    # What is at work ends, and what a worker was given already may begin before it hears.
    begun = [0]
    while len(begun) == 1 or begun[-1] > begun[-2]:
        time.sleep(1)
        begun.append(len(list(tmp_path.iterdir())))
    assert begun[-1] < 30


def test_workers_that_die_at_work_and_while_their_result_is_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A worker that is lost is enough to give its work up.
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    with started_cluster(3, tmp_path) as (address, _, workers):
        # Work whose result is lost is done again, as it is not what its worker died at.
        answered = list(in_order(partial(deadly_at_one, tmp_path), range(2), address))
        assert answered == ["0", "survived"]
        assert len(list(tmp_path.glob("made 1 *"))) == 2
        answered = list(in_order(die_at_zero, range(2), address, given_up))
        assert answered == ["0: 1 worker(s) died at this work", "1"]
        with pytest.raises(InputError, match="died at this work"):
            list(in_order(die_at_zero, range(1), address))
        assert all(worker.wait() for worker in workers)


def test_a_cluster_waits_for_a_late_worker_and_misses_its_scheduler(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with started_cluster(0, tmp_path) as (address, scheduler, workers):
        threading.Timer(0.5, lambda: workers.append(start_worker(tmp_path))).start()
        answers = in_order(partial(begin_slowly, tmp_path), range(1000), address)
        assert [next(answers), next(answers)] == [0, 1]
        assert f"no worker yet; `dask worker {address}` starts one" in capfd.readouterr().err
        scheduler.kill()
        with pytest.raises(InputError, match=f"{address}: the connection to the scheduler is lost"):
            list(answers)
        assert capfd.readouterr().err == ""


def test_a_cluster_without_the_package_and_a_worker_with_threads_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = tmp_path / "empty"
    (empty / "egolane_pgm").mkdir(parents=True)
    (empty / "egolane_pgm" / "__init__.py").write_text("raise ModuleNotFoundError('not here')")
    with started_cluster(0, tmp_path) as (address, _, workers):
        with monkeypatch.context() as without:
            without.setenv("PYTHONPATH", str(empty))
            without.chdir(empty)
            workers.append(start_worker(tmp_path))
        until_there_is_one(address)
        with pytest.raises(InputError, match=r"tcp:\S+ cannot import egolane_pgm: not here"):
            list(in_order(ten_times, range(2), address))
        workers[0].kill()
        workers.append(start_worker(tmp_path, threads=2))
        with pytest.raises(InputError, match="has threads; start it with `--nthreads 1`"):
            list(in_order(ten_times, range(2), address))


def until_there_is_one(address: str) -> None:
    from distributed import Client

    with Client(address) as client:
        client.wait_for_workers(1)


def test_a_cluster_of_this_machine_ends_with_its_work(capfd: pytest.CaptureFixture[str]) -> None:
    assert list(in_order(ten_times, range(3), "local:1")) == [0, 10, 20]
    assert "Dask dashboard: http://" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tcp://127.0.0.1:9", "no scheduler answers; `dask scheduler` starts one"),
        ("nowhere", "no scheduler answers"),
        ("local:none", "write local:4 for four processes"),
        ("local:0", "write local:4 for four processes"),
    ],
)
def test_a_cluster_that_is_not_there_is_refused_in_one_line(
    address: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "_SECONDS_TO_ANSWER", 1)
    with pytest.raises(InputError) as refused, executor(address):
        pass
    assert message in str(refused.value)
    assert str(refused.value).startswith(f"--cluster {address}: ")


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'egolane-pgm\[cluster\]'"):
        list(in_order(ten_times, range(2), "local:2"))
