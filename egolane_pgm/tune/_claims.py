"""Telling results and claiming trials, in one transaction that holds the lock of its study.

So the total is exact: finished and running trials together are never more than asked for, and no
worker leaves before all are finished. The transaction may be repeated after a connection broke in
the middle of its commit: results that are there already are not written again, and what was
claimed without the worker's knowing is handed out to it again. All times are the server's.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from egolane_pgm.tune._connection import Link
from egolane_pgm.tune._proposers import Offer, Proposer
from egolane_pgm.tune.space import Point, SearchSpace, distributions
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import psycopg

#: Trials that a worker claims at once: cheap trials are scored side by side, and kept together.
CLAIM = 8

_LOCK = "SELECT 1 FROM egolane_studies WHERE study_id = %(study)s FOR UPDATE"

_BEAT = "UPDATE egolane_workers SET seen = clock_timestamp() WHERE worker = %(worker)s"

# A trial that was given to another worker in the meantime is not told: its score is dropped.
_TELL = """
WITH told AS (
    SELECT * FROM unnest(%(told)s::int[], %(objectives)s::int[], %(scores)s::float8[])
        AS t(trial_id, objective, value)
), mine AS (
    UPDATE egolane_claims c SET done = s.finished + 1, scores = ARRAY(
        SELECT value FROM told WHERE told.trial_id = c.trial_id ORDER BY objective)
    FROM egolane_studies s
    WHERE s.study_id = c.study_id AND c.trial_id = ANY(%(told)s::int[])
        AND c.worker = %(worker)s AND c.done IS NULL
    RETURNING c.trial_id
), kept AS (
    INSERT INTO trial_values (trial_id, objective, value, value_type)
    SELECT trial_id, objective, value, 'FINITE' FROM told JOIN mine USING (trial_id)
), ended AS (
    UPDATE trials SET state = 'COMPLETE', datetime_complete = timezone('UTC', clock_timestamp())
    FROM mine WHERE trials.trial_id = mine.trial_id
)
UPDATE egolane_studies SET finished = finished + n, running = running - n
FROM (SELECT count(*)::int AS n FROM mine) AS counted WHERE study_id = %(study)s
RETURNING asked, finished, running, next_number, n
"""

_NEWS = """
SELECT number, point, scores, attrs FROM egolane_claims
WHERE study_id = %(study)s AND done > %(seen)s AND worker <> %(worker)s ORDER BY number
"""

_OUTSTANDING = """
SELECT trial_id, number, point FROM egolane_claims
WHERE study_id = %(study)s AND done IS NULL AND worker = %(worker)s ORDER BY number
"""

# Everybody has a grace period anew after the server was started.
_DEAD = """
SELECT trial_id, number, point, attrs FROM egolane_claims
WHERE study_id = %(study)s AND done IS NULL AND worker = (
    SELECT c.worker FROM egolane_claims c JOIN egolane_studies s USING (study_id)
        LEFT JOIN egolane_workers w ON w.worker = c.worker
    WHERE c.study_id = %(study)s AND c.done IS NULL AND c.worker <> %(worker)s AND (
        coalesce(w.seen, '-infinity') = '-infinity'
        OR greatest(w.seen, pg_postmaster_start_time())
            < clock_timestamp() - make_interval(secs => s.grace_s))
    LIMIT 1)
ORDER BY number
"""

_LOSE = """
WITH lost AS (
    UPDATE egolane_claims SET done = 0 WHERE trial_id = ANY(%(lost)s::int[]) AND done IS NULL
    RETURNING trial_id
), ended AS (
    UPDATE trials SET state = 'FAIL', datetime_complete = timezone('UTC', clock_timestamp())
    FROM lost WHERE trials.trial_id = lost.trial_id
)
UPDATE egolane_studies SET running = running - n, lost = lost + n
FROM (SELECT count(*)::int AS n FROM lost) AS counted WHERE study_id = %(study)s
"""

_CLAIM = """
WITH given AS (
    SELECT * FROM unnest(%(numbers)s::int[], %(retries)s::int[], %(attrs)s::text[])
        AS g(number, retry_of, attrs)
), value AS (
    SELECT * FROM unnest(%(of)s::int[], %(position)s::int[], %(value)s::float8[])
        AS v(number, position, value)
), made AS (
    INSERT INTO trials (number, study_id, state, datetime_start)
    SELECT number, %(study)s, 'RUNNING', timezone('UTC', clock_timestamp()) FROM given
    ORDER BY number
    RETURNING trial_id, number
), parameters AS (
    INSERT INTO trial_params (trial_id, param_name, param_value, distribution_json)
    SELECT trial_id, name, value, distribution
    FROM made JOIN value USING (number)
        JOIN unnest(%(names)s::text[], %(ranges)s::text[]) WITH ORDINALITY
            AS r(name, distribution, position) USING (position)
), attributes AS (
    INSERT INTO trial_user_attributes (trial_id, key, value_json)
    SELECT trial_id, 'worker', %(worker_json)s FROM made
    UNION ALL SELECT trial_id, 'retry_of', retry_of::text FROM made JOIN given USING (number)
        WHERE retry_of IS NOT NULL
), claimed AS (
    INSERT INTO egolane_claims (trial_id, study_id, number, worker, point, attrs, retry_of)
    SELECT trial_id, %(study)s, number, %(worker)s, ARRAY(
            SELECT value FROM value WHERE value.number = made.number ORDER BY position),
        attrs::jsonb, retry_of
    FROM made JOIN given USING (number)
), counted AS (
    UPDATE egolane_studies SET running = running + n, next_number = next_number + n
    FROM (SELECT count(*)::int AS n FROM given) AS g WHERE study_id = %(study)s
)
SELECT trial_id, number FROM made ORDER BY number
"""


@dataclass(frozen=True)
class Claimed:
    """A trial to do."""

    trial_id: int
    number: int
    point: Mapping[str, Any]


@dataclass(frozen=True)
class Told:
    """A trial that was done. attrs: what its sampler noted when it proposed it."""

    number: int
    params: Mapping[str, Any]
    values: Sequence[float]
    attrs: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Answer:
    """What came of telling and claiming. kept: results that counted."""

    claimed: list[Claimed]
    kept: int
    asked: int
    finished: int

    @property
    def is_done(self) -> bool:
        """Whether every trial of the study is finished."""
        return self.finished >= self.asked


class Claims:
    """One worker at one study."""

    def __init__(
        self, link: Link, study_id: int, worker: str, space: SearchSpace, proposer: Proposer
    ) -> None:
        from optuna.distributions import distribution_to_json

        self.link = link
        self.space = space
        self.proposer = proposer
        self.ranges = distributions(space)
        self.seen = 0
        self.given: dict[str, Any] = {
            "study": study_id,
            "worker": worker,
            "worker_json": json.dumps(worker),
            "names": list(space.keys),
            "ranges": [distribution_to_json(self.ranges[key]) for key in space.keys],
        }

    def exchange(
        self, results: Sequence[tuple[Claimed, Sequence[float]]], at_most: int = CLAIM
    ) -> Answer:
        """Tell results, learn others', and claim the next trials: none when there are enough.
        Raises InputError where the storage stays away, or the study was removed."""
        self.proposer.learn([Told(c.number, c.point, values) for c, values in results])
        self.proposer.prepare()
        told = [(c.trial_id, k, v) for c, values in results for k, v in enumerate(values)]
        given = {
            **self.given,
            "told": [row[0] for row in told],
            "objectives": [row[1] for row in told],
            "scores": [row[2] for row in told],
            "seen": self.seen,
        }
        answer, news, seen = self.link.steady(lambda c: self._transaction(c, given, at_most))
        self.proposer.learn(news)
        self.proposer.taken([c.point for c in answer.claimed])
        self.seen = seen
        return answer

    def _transaction(
        self, connection: psycopg.Connection[Any], given: dict[str, Any], at_most: int
    ) -> tuple[Answer, list[Told], int]:
        with connection.pipeline():
            connection.execute("BEGIN")
            connection.execute(_LOCK, given)
            connection.execute(_BEAT, given)
            told = connection.execute(_TELL, given)
            found = connection.execute(_NEWS, given)
            mine = connection.execute(_OUTSTANDING, given)
            dead = connection.execute(_DEAD, given)
        row = told.fetchone()
        if row is None:
            raise InputError(f"storage {self.link.address.shown}: the study was removed meanwhile")
        asked, finished, running, number, kept = row
        news = [Told(n, self._point(p), s, a) for n, p, s, a in found]
        outstanding = [Claimed(t, n, self._point(p)) for t, n, p in mine]
        lost = list(dead)
        left = asked - finished - running
        offers: list[Offer] = []
        if not outstanding and lost and at_most:
            offers = [Offer(self._point(p), a, n) for _, n, p, a in lost]
        elif not outstanding and left > 0 and at_most:
            self.proposer.learn(news)
            news = []
            offers = self.proposer.offer(number, min(left, at_most))
        claimed = outstanding
        with connection.pipeline():
            if offers:
                if offers[0].retry_of is not None:
                    connection.execute(_LOSE, {**given, "lost": [row[0] for row in lost]})
                new = connection.execute(_CLAIM, {**given, **self._rows(number, offers)})
            connection.execute("COMMIT")
        if offers:
            rows = zip(new, offers, strict=True)
            claimed = [Claimed(t, n, offer.point) for (t, n), offer in rows]
        return Answer(claimed, kept, asked, finished), news, finished

    def _rows(self, first: int, offers: Sequence[Offer]) -> dict[str, Any]:
        numbers = range(first, first + len(offers))
        values = [
            (n, k + 1, self.ranges[key].to_internal_repr(offer.point[key]))
            for n, offer in zip(numbers, offers, strict=True)
            for k, key in enumerate(self.space.keys)
        ]
        return {
            "numbers": list(numbers),
            "retries": [offer.retry_of for offer in offers],
            "attrs": [None if not o.attrs else json.dumps(dict(o.attrs)) for o in offers],
            "of": [row[0] for row in values],
            "position": [row[1] for row in values],
            "value": [row[2] for row in values],
        }

    def _point(self, values: Sequence[float]) -> Point:
        return {
            key: self.ranges[key].to_external_repr(value)
            for key, value in zip(self.space.keys, values, strict=True)
        }


def enlist(link: Link, worker: str, job: str, host: str, pid: int) -> None:
    """Enter a worker."""
    link.steady(
        lambda c: c.execute(
            "INSERT INTO egolane_workers (worker, job, host, pid) VALUES (%s, %s, %s, %s)"
            " ON CONFLICT (worker) DO UPDATE SET seen = clock_timestamp()",
            [worker, job, host, pid],
        )
    )


def beat(link: Link, worker: str) -> None:
    """Say that a worker is alive."""
    link.beat(lambda c: c.execute(_BEAT, {"worker": worker}))


def bury(link: Link, workers: Sequence[str]) -> None:
    """Workers that are known to be gone: others may take their trials at once."""
    link.steady(
        lambda c: c.execute(
            "UPDATE egolane_workers SET seen = '-infinity' WHERE worker = ANY(%s)", [list(workers)]
        )
    )
