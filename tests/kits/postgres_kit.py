"""What the tests of shared studies have in common: one server for all of them, small studies, and
machines, which are processes."""

from __future__ import annotations

import multiprocessing
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.address import parse
from egolane_pgm.tune.postgres import Part, account, begin_job
from egolane_pgm.tune.shared import SharedJob, Task, run_shared, work
from egolane_pgm.tune.study import Settings
from tests.kits.postgres_server import Server
from tests.kits.tuning_kit import bowl, plain_space, slow_bowl

FORK = multiprocessing.get_context("fork")
SPACE = plain_space()
TRIALS = 90
started: list[Any] = []
START = {"x0": 0.5, "x1": 0.5, "x2": 0.5}

#: A user who is asked for a password, with everything in it that an address must escape.
GUARDED, PASSWORD = "warden", "s3cret/with:p@rts%and blanks"


def settings(sampler: str = "evolution", trials: int = TRIALS, seed: int = 0) -> Settings:
    objectives = ("accuracy", "f1") if sampler == "nsga2" else ("accuracy",)
    return Settings(objectives, sampler, trials, seed)


def twice(points: Any) -> Any:
    """Two objectives."""
    import numpy as np

    scores = bowl(points)
    return np.concatenate([scores, 1 - scores], axis=1)


def make_job(
    url: str,
    name: str,
    sampler: str = "evolution",
    trials: int = TRIALS,
    evaluate: Callable[[Any], Any] = slow_bowl,
    grace_s: float = 30.0,
    identity: Any = None,
) -> SharedJob:
    """A job of one study, begun or found."""
    address = parse(url)
    chosen = settings(sampler, trials)
    part = Part(name, "all", 0, 1, SPACE, chosen, {"identity": identity or {"seed": 0}})
    link = Link(address)
    kept = begin_job(link, name, [part], grace_s)
    link.close()
    return SharedJob(address, name, [Task(kept[0], SPACE, evaluate, chosen, [START])])


def machine(url: str, name: str, n_workers: int = 2, **options: Any) -> None:
    """What `egolane tune --storage` does on one machine."""
    run_shared(make_job(url, name, **options), n_workers)


def start(work_: Callable[..., None], *words: Any, **options: Any) -> Any:
    """A process that does something."""
    process = FORK.Process(target=work_, args=words, kwargs=options)
    process.start()
    started.append(process)
    return process


def end_all() -> None:
    """Kill what a test that failed left running; their workers end with them."""
    for process in started:
        process.kill()
        process.join()
    started.clear()


def alone(job: SharedJob, worker: str) -> None:
    """A worker that nobody on its machine looks after."""
    work(job, worker, lambda: True)


def rows(server: Server, url: str, query: str) -> list[Any]:
    """A query, done by the superuser."""
    return server.execute(query, url.rpartition("/")[2])


def states(server: Server, url: str, name: str) -> Counter[str]:
    """How many trials of a study are in each state."""
    query = (
        "SELECT state::text, count(*)::int FROM trials JOIN studies USING (study_id)"
        f" WHERE study_name = '{name}' GROUP BY state"
    )
    return Counter(dict(rows(server, url, query)))


def wait_for(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


def wait_for_trials(server: Server, url: str, name: str, count: int = 1) -> None:
    """Wait until a study has finished some trials."""

    def there() -> bool:
        found = rows(server, url, "SELECT to_regclass('egolane_claims') IS NOT NULL")
        return bool(found[0][0]) and states(server, url, name)["COMPLETE"] >= count

    wait_for(there)


def finished(server: Server, url: str, name: str) -> dict[int, tuple[Any, Any]]:
    """Point and scores of each finished trial, by its number, as Optuna's tables have them."""
    query = (
        "SELECT number, (SELECT array_agg(param_value ORDER BY param_name) FROM trial_params p"
        " WHERE p.trial_id = t.trial_id), (SELECT array_agg(value ORDER BY objective)"
        " FROM trial_values v WHERE v.trial_id = t.trial_id)"
        " FROM trials t JOIN studies USING (study_id)"
        f" WHERE study_name = '{name}' AND state = 'COMPLETE' ORDER BY number"
    )
    return {number: (point, scores) for number, point, scores in rows(server, url, query)}


def is_whole(
    server: Server, url: str, name: str, trials: int = TRIALS, sampler: str = "evolution"
) -> None:
    """No finished trial lost, none counted twice, the total exact, every score right."""
    counted = states(server, url, name)
    assert counted["COMPLETE"] == trials
    assert set(counted) <= {"COMPLETE", "FAIL"}
    link = Link(parse(url))
    found = account(link, name)
    link.close()
    assert (found.asked, found.finished, found.running) == (trials, trials, 0)
    assert found.counted_twice == 0
    assert found.lost == found.retried == counted["FAIL"]
    done = finished(server, url, name)
    if sampler == "random":
        # Evolution may try a point again of its own accord.
        assert max(Counter(tuple(point) for point, _ in done.values()).values()) == 1
    for point, scores in done.values():
        assert scores[0] == bowl([dict(zip(SPACE.keys, point, strict=True))])[0, 0]
    numbers = rows(
        server,
        url,
        "SELECT number FROM trials JOIN studies USING (study_id)"
        f" WHERE study_name = '{name}' ORDER BY trial_id",
    )
    assert [row[0] for row in numbers] == list(range(sum(counted.values())))
    books = rows(
        server,
        url,
        "SELECT asked, finished, running, lost, next_number FROM egolane_studies"
        f" WHERE job = '{name}'",
    )
    assert books == [(trials, trials, 0, counted["FAIL"], sum(counted.values()))]


def address_with_password(url: str) -> str:
    """The address of a database for the guarded user, with the password in it."""
    from urllib.parse import quote

    host = url.rpartition("@")[2]
    return f"postgresql+psycopg://{GUARDED}:{quote(PASSWORD, safe='')}@{host}"
