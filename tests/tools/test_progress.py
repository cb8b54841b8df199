"""How long something will take is said once, by its first items, and by no guess."""

from __future__ import annotations

import logging
from concurrent.futures import Future
from functools import partial
from typing import Any

import pytest
from click.testing import CliRunner

from egolane_pgm.cli import main
from egolane_pgm.tools.progress import LOGGER, Ahead, at_once, bar
from egolane_pgm.tuning import study


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    monkeypatch.setattr(LOGGER, "info", lambda line, *values: lines.append(line % values))
    return lines


def work(clock: Clock, ahead: Ahead, times: list[float], items: int = 1) -> None:
    for seconds in times:
        clock.now += seconds
        ahead.add(items)


def test_the_first_item_in_which_things_are_loaded_does_not_count(said: list[str]) -> None:
    clock = Clock()
    ahead = Ahead(600, "trial", clock=clock)
    work(clock, ahead, [4.0, 0.5])
    assert said == [], "half a second says little"
    work(clock, ahead, [0.5, 7.0])
    assert said == ["about 5 minutes to go: 597 trials, 0.5 s each"]


def test_a_long_first_item_counts(said: list[str]) -> None:
    clock = Clock()
    ahead = Ahead(10, "recording", clock=clock)
    work(clock, ahead, [600.0, 1.0])
    assert said == ["about 2 hours to go: 9 recordings, 600 s each"]


@pytest.mark.parametrize("times", [[0.5, 1.0, 1.0], [0.1] * 100])
def test_what_is_done_soon_is_not_announced(said: list[str], times: list[float]) -> None:
    clock = Clock()
    work(clock, Ahead(len(times), "trial", clock=clock), times)
    assert said == []


def test_workers_share_what_is_left(said: list[str]) -> None:
    clock = Clock()
    ahead = Ahead(22, "search", 2, clock=clock)
    # Two begin at once and take 5 seconds each; the second answer comes right after the first.
    work(clock, ahead, [5.0, 0.0, 5.0])
    assert said == [], "the other worker has not answered"
    work(clock, ahead, [0.0])
    assert said == ["about 45 seconds to go: 18 searches, 5.0 s each, 2 at a time"]


def test_a_study_that_a_worker_does_counts_with_all_its_trials(said: list[str]) -> None:
    clock = Clock()
    ahead = Ahead(30_000, "trial", 2, clock=clock)
    work(clock, ahead, [30.0], items=3000)
    assert said == ["about 2 minutes to go: 27,000 trials, 10 ms each, 2 at a time"]


def test_nothing_is_said_where_nobody_knows_how_much_there_is(said: list[str]) -> None:
    for total, workers in ((0, 1), (1, 1), (50, 0)):
        clock = Clock()
        work(clock, Ahead(total, "frame", workers, clock), [30.0, 30.0])
    assert said == []


def test_jobs_are_no_more_than_the_machine_has_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    assert [at_once(jobs) for jobs in (1, 3, 9)] == [1, 3, 4]
    assert [at_once(jobs) for jobs in ("local:2", "tcp://host:8786")] == [2, 0]


@pytest.mark.parametrize("is_told", [False, True])
def test_a_hidden_bar_announces_too(
    said: list[str], monkeypatch: pytest.MonkeyPatch, is_told: bool
) -> None:
    clock = Clock()
    monkeypatch.setattr("egolane_pgm.tools.progress.Ahead", partial(Ahead, clock=clock))

    def slow(items: Any) -> None:
        clock.now += 25.0

    if is_told:
        with bar(None, False, total=3, unit="fit") as shows:
            for k in range(3):
                slow(k)
                shows.update()
    else:
        assert [slow(k) for k in bar(range(3), False, unit="fit")] == [None] * 3
    assert said == ["about 50 seconds to go: 2 fits, 25 s each"]


def test_a_study_of_another_process_tells_its_pace_before_it_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, told = Clock(), list[float]()
    future: Future[int] = Future()
    # Before, while the process loads, and then once a second.
    trials = iter([7, 7, 8, 108])

    def wait(left: set[Future[int]], seconds: float | None, _: str) -> tuple[set, set]:
        if told:
            assert seconds is None, "nothing is left to be found out"
            return left, set()
        clock.now += seconds or 0.0
        return set(), left

    monkeypatch.setattr(study, "wait", wait)
    monkeypatch.setattr(study, "n_complete", lambda _: next(trials))
    monkeypatch.setattr("time.monotonic", clock)
    assert list(study._as_done([future], Any, told.append)) == [future]
    assert told == [0.01]


def test_a_command_says_it_on_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def announce(*_: Any) -> None:
        LOGGER.info("about 9 minutes to go: 3 runs, 180 s each")

    monkeypatch.setattr("egolane_pgm.cli.show.ls.callback", announce)
    done = CliRunner().invoke(main.egolane, ["ls"])
    assert (done.stdout, done.stderr) == ("", "about 9 minutes to go: 3 runs, 180 s each\n")
    assert not LOGGER.handlers
    assert LOGGER.level == logging.NOTSET
