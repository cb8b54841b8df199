from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from egolane_pgm import cluster
from egolane_pgm.parallel import executor, in_order
from egolane_pgm.types import InputError
from tests.cluster_demo import cluster as started_cluster

pytest.importorskip("distributed")


def ten_times(k: int) -> int:
    return 10 * k


def die_at_zero(k: int) -> str:
    if k == 0:
        os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
    return str(k)


def given_up(k: int, why: str) -> str:
    return f"{k} died"


def refuse_two(k: int) -> int:
    if k == 2:
        raise InputError("two")
    return k


def test_a_summary_is_the_same_though_a_worker_is_killed_and_one_is_added() -> None:
    words = ["--drives", "12", "--frames", "60", "--workers", "2"]
    command = [sys.executable, "-m", "tests.cluster_demo", *words]
    # Rarely an answer that is lost with its worker is waited for without end: tried once more.
    for _ in range(2):
        run = subprocess.Popen(command, cwd=Path(__file__).parents[1], start_new_session=True)
        try:
            assert run.wait(timeout=240) == 0
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
        else:
            return
    pytest.fail("the demo did not end")


def test_a_cluster_tells_of_errors_of_other_code_and_of_what_kills_its_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A worker that is lost is enough to give its work up.
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    with started_cluster(2, tmp_path) as (address, _):
        answers = in_order(refuse_two, range(4), address)
        assert [next(answers), next(answers)] == [0, 1]
        with pytest.raises(InputError, match="two"):
            next(answers)
        here = cluster.code()
        with monkeypatch.context() as changed:
            changed.setattr(cluster, "code", lambda: {**here, "numpy": "1.0"})
            other = r"has numpy .*, this machine 1.0; install the same"
            with pytest.raises(InputError, match=other):
                list(in_order(ten_times, range(2), address))
        answered = list(in_order(die_at_zero, range(4), address, given_up))
        assert answered == ["0 died", "1", "2", "3"]


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
