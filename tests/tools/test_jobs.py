from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import pytest

from egolane_pgm.tools.jobs import executor, in_order
from egolane_pgm.types import InputError


def ten_times(k: int) -> int:
    return 10 * k


def leave_a_file(folder: Path, k: int) -> int:
    (folder / f"{k} {os.getpid()}").touch()
    time.sleep(0.1)
    return k


def clean_up_behind_itself(folder: Path, k: int) -> int:
    if k == 0:
        return k
    try:
        (folder / f"half {k}").touch()
        # From now on it may be ended.
        (folder / f"{k} {os.getpid()}").touch()
        time.sleep(60)
    finally:
        (folder / f"half {k}").unlink()
    return k


class SlowToGo:
    def __del__(self) -> None:
        time.sleep(60)


def remove_what_is_slow_to_go(folder: Path, k: int) -> int:
    if k == 0:
        return k
    (folder / f"{k} {os.getpid()}").touch()
    slow = SlowToGo()
    del slow
    return k


def die_at(numbers: tuple[int, ...], k: int) -> str:
    if k in numbers:
        os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
    time.sleep(0.2)
    return str(k)


def given_up(k: int, why: str) -> str:
    return f"{k} {why.split()[-1]}"


def refuse_three(k: int) -> int:
    if k == 3:
        raise InputError("three")
    return k


def warn(k: int) -> int:
    warnings.warn(f"number {k}", UserWarning, stacklevel=1)
    return k


def a_function(_: int) -> object:
    return lambda: None


@pytest.mark.parametrize("jobs", [1, 2])
def test_answers_come_in_order(jobs: int) -> None:
    assert list(in_order(ten_times, range(7), jobs)) == [0, 10, 20, 30, 40, 50, 60]
    with executor(jobs) as pool:
        assert pool.submit(ten_times, 3).result() == 30
        assert list(pool.map(ten_times, range(3))) == [0, 10, 20]


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_the_work_is_raised_in_its_turn(jobs: int) -> None:
    answers = in_order(refuse_three, range(6), jobs)
    assert [next(answers) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match="three"):
        next(answers)


@pytest.mark.parametrize("jobs", [1, 2])
def test_warnings_of_the_work_are_heard(jobs: int) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert list(in_order(warn, range(3), jobs)) == [0, 1, 2]
    assert [str(w.message) for w in caught] == ["number 0", "number 1", "number 2"]


def test_what_cannot_be_pickled_is_an_error() -> None:
    with pytest.raises(Exception, match=r"pickle|local object"):
        list(in_order(lambda k: k, range(4), 2))
    with pytest.raises(Exception, match=r"pickle|local object"):
        list(in_order(a_function, range(4), 2))


@pytest.mark.parametrize("jobs", [1, 2])
def test_nothing_is_begun_after_the_work_is_left(tmp_path: Path, jobs: int) -> None:
    answers = in_order(partial(leave_a_file, tmp_path), range(60), jobs)
    assert next(answers) == 0
    answers.close()  # type: ignore[attr-defined]
    begun = len(list(tmp_path.iterdir()))
    assert begun < 30
    time.sleep(0.3)
    assert len(list(tmp_path.iterdir())) == begun


def test_work_that_is_left_cleans_up_behind_itself(tmp_path: Path) -> None:
    answers = in_order(partial(clean_up_behind_itself, tmp_path), range(4), 2)
    assert next(answers) == 0
    until_there_are(2, tmp_path)
    began = time.perf_counter()
    answers.close()  # type: ignore[attr-defined]
    assert time.perf_counter() - began < 30
    assert list(tmp_path.glob("half *")) == []
    assert not any(is_running(pid) for pid in pids(tmp_path))


def test_a_process_that_is_told_to_end_while_it_removes_an_object_says_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    answers = in_order(partial(remove_what_is_slow_to_go, tmp_path), range(3), 2)
    assert next(answers) == 0
    until_there_are(2, tmp_path)
    answers.close()
    assert not any(is_running(pid) for pid in pids(tmp_path))
    assert capfd.readouterr().err == ""


def test_a_process_that_dies_costs_what_was_at_work_and_nothing_else() -> None:
    answers = list(in_order(partial(die_at, (5,)), range(12), 2, died=given_up))
    lost = [k for k, answer in enumerate(answers) if answer != str(k)]
    assert 5 in lost
    assert set(lost) <= {4, 5, 6}
    assert answers[5] == "5 memory?)"
    with pytest.raises(InputError, match="a process died"):
        list(in_order(partial(die_at, (0,)), range(3), 2))


def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    program = (
        "import sys; from functools import partial; from pathlib import Path\n"
        "from egolane_pgm.tools.jobs import in_order\n"
        "from tests.test_parallel import clean_up_behind_itself\n"
        "list(in_order(partial(clean_up_behind_itself, Path(sys.argv[1])), range(4), 2))"
    )
    running = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], cwd=Path(__file__).parents[1]
    )
    until_there_are(2, tmp_path)
    children = pids(tmp_path)
    running.kill()
    running.wait()
    for _ in range(600):
        if not any(map(is_running, children)):
            break
        time.sleep(0.1)
    assert not any(map(is_running, children))


def until_there_are(n: int, folder: Path) -> None:
    for _ in range(600):
        if len(pids(folder)) == n:
            return
        time.sleep(0.05)
    raise AssertionError(f"{n} pieces of work were not begun")


def pids(folder: Path) -> list[int]:
    return [int(file.name.split()[1]) for file in folder.glob("[0-9]* *")]


def is_running(pid: int) -> bool:
    listed = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return listed.stdout.strip() not in ("", "Z", "Z+", "Zs")
