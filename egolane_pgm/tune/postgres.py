"""Studies in a PostgreSQL database: begun, listed, read and accounted for.

The database is one of Optuna's (its dashboard and `optuna.load_study` read it) with tables of our
own beside it, see `_tables`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from egolane_pgm.tune._connection import Link
from egolane_pgm.tune._tables import check_tables, make_tables
from egolane_pgm.tune.address import Address
from egolane_pgm.tune.space import SearchSpace, differences, distributions
from egolane_pgm.tune.study import Settings
from egolane_pgm.types import InputError, suggestion

if TYPE_CHECKING:
    import psycopg
    from optuna.trial import FrozenTrial

#: Seconds without a word after which a worker is dead, where nothing else is said.
GRACE_S = 60.0

#: The longest that makes sense (a day), and the largest number of the column.
MOST_GRACE_S, MOST_TRIALS = 86_400.0, 2**31 - 1

#: Seconds that the rate of a study is measured over.
RATE_S = 60


@dataclass(frozen=True)
class Part:
    """A study of a job. kind: `all` frames, or without a `block` or a `recording`; part of
    n_parts, from 0. attributes: what the study's creator says about it."""

    name: str
    kind: str
    part: int
    n_parts: int
    space: SearchSpace
    settings: Settings
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class Kept:
    """A study as the database has it."""

    study_id: int
    name: str
    job: str
    kind: str
    part: int
    n_parts: int
    asked: int
    grace_s: float
    attributes: Mapping[str, Any]


def begin_job(link: Link, job: str, parts: Sequence[Part], grace_s: float) -> list[Kept]:
    """The studies of a job, made where they are not there yet; of two that do this at once one
    makes them and the other finds them. Totals may grow.

    Raises InputError, and then nothing was changed, where a study of that name was not made by
    egolane or is another one, and for a grace period or a total that the database cannot hold.
    """
    if not 0 < grace_s <= MOST_GRACE_S:
        raise InputError(f"--grace: {grace_s:g} s is not above 0 and at most {MOST_GRACE_S:g}")
    most = max(part.settings.trials for part in parts)
    if most > MOST_TRIALS:
        raise InputError(f"{job}: trials: {most} is more than a storage counts, {MOST_TRIALS}")
    make_tables(link)

    def begin(connection: psycopg.Connection[Any]) -> None:
        with connection.transaction():
            for part in parts:
                _begin_part(connection, link.address, job, part, grace_s)

    link.steady(begin)
    found = {kept.name: kept for kept in find_job(link, job)}
    return [found[part.name] for part in parts]


def check_same(
    address: Address, name: str, found: Mapping[str, Any], mine: Mapping[str, Any]
) -> None:
    """Raise InputError, saying what differs, where this machine would score something else than
    the one that began a study. found, mine: its attributes; `identity` and `code` are compared."""
    unlike = []
    for key in ("identity", "code"):
        unlike += differences(found.get(key, {}), mine.get(key, {}), f"{key}.")
    if unlike:
        shown = "; ".join(unlike[:5]).replace(", now ", ", here ")
        raise InputError(
            f"storage {address.shown}: study {name} was begun with other data, search space or"
            f" code ({shown}); no trial was taken, nothing changed; make them the same, or give"
            " your study another name"
        )


def _begin_part(
    connection: psycopg.Connection[Any], address: Address, job: str, part: Part, grace_s: float
) -> None:
    from optuna.distributions import distribution_to_json

    row = connection.execute(
        "INSERT INTO studies (study_name) VALUES (%s) ON CONFLICT (study_name) DO NOTHING"
        " RETURNING study_id",
        [part.name],
    ).fetchone()
    if row is None:
        found = connection.execute(
            "SELECT study_id, json_object_agg(key, value_json::json) FROM egolane_studies"
            " JOIN studies USING (study_id) LEFT JOIN study_user_attributes USING (study_id)"
            " WHERE job = %s AND study_name = %s GROUP BY study_id",
            [job, part.name],
        ).fetchone()
        if found is None:
            raise InputError(
                f"storage {address.shown}: holds another study named {part.name}; give yours"
                " another name"
            )
        check_same(address, part.name, found[1], part.attributes)
        connection.execute(
            "UPDATE egolane_studies SET asked = greatest(asked, %s) WHERE study_id = %s",
            [part.settings.trials, found[0]],
        )
        return
    for k, direction in enumerate(part.settings.directions):
        connection.execute(
            "INSERT INTO study_directions (direction, study_id, objective)"
            " VALUES (%s::studydirection, %s, %s)",
            [direction.upper(), row[0], k],
        )
    ranges = distributions(part.space).items()
    described = {
        "objective": list(part.settings.objectives),
        "space": {key: json.loads(distribution_to_json(r)) for key, r in ranges},
        **part.attributes,
    }
    for key, value in described.items():
        connection.execute(
            "INSERT INTO study_user_attributes (study_id, key, value_json) VALUES (%s, %s, %s)",
            [row[0], key, json.dumps(value)],
        )
    connection.execute(
        "INSERT INTO egolane_studies (study_id, job, kind, part, n_parts, asked, grace_s)"
        " VALUES (%s, %s, %s, %s, %s, %s, %s)",
        [row[0], job, part.kind, part.part, part.n_parts, part.settings.trials, grace_s],
    )


def find_job(link: Link, job: str) -> list[Kept]:
    """The studies of a job, the one on all frames first; raises InputError as the storage does,
    and for a job that is not there, with a suggestion."""
    require_tables(link)

    def find(connection: psycopg.Connection[Any]) -> tuple[list[Kept], dict[str, str]]:
        rows: list[Any] = connection.execute(
            "SELECT study_id, study_name, job, kind, part, n_parts, asked, grace_s, (SELECT"
            " json_object_agg(key, value_json::json) FROM study_user_attributes a WHERE"
            " a.study_id = s.study_id) FROM egolane_studies s JOIN studies USING (study_id)"
            " WHERE job = %s ORDER BY kind <> 'all', study_id",
            [job],
        ).fetchall()
        jobs = connection.execute(
            "SELECT study_name, job FROM egolane_studies JOIN studies USING (study_id)"
        ).fetchall()
        return [Kept(*row) for row in rows], dict(jobs)

    kept, others = link.once(find)
    if not kept and job in others:
        raise InputError(
            f"storage {link.address.shown}: study {job} is a part of {others[job]}; take that one"
        )
    if not kept:
        raise InputError(
            f"storage {link.address.shown}: no study {job}{suggestion(job, set(others.values()))};"
            " `egolane studies` lists them"
        )
    return kept


def require_tables(link: Link) -> None:
    """Raise InputError where no study was ever kept there."""
    if not check_tables(link):
        raise InputError(
            f"storage {link.address.shown}: has no tables of studies; start one with `egolane tune"
            " EXPERIMENT --storage ...`"
        )


@dataclass(frozen=True)
class Listed:
    """A line of the list. rate: trials per second of the last minute, or since the study was begun,
    None where there were none. workers: alive, at any study of the job. best: first objective, None
    where nothing is finished."""

    name: str
    job: str
    asked: int
    finished: int
    running: int
    lost: int
    rate: float | None
    workers: int
    best: float | None
    objective: str


_LIST = f"""
SELECT study_name, job, asked, finished, running, lost,
    (SELECT count(*) / extract(epoch FROM least(interval '{RATE_S} s',
            clock_timestamp() - s.created + interval '1 ms'))
        FROM trials t WHERE t.study_id = s.study_id AND state = 'COMPLETE' AND datetime_complete
            > timezone('UTC', clock_timestamp()) - interval '{RATE_S} s'),
    (SELECT count(*) FROM egolane_workers w WHERE w.job = s.job
        AND seen > clock_timestamp() - make_interval(secs => s.grace_s)),
    (SELECT CASE WHEN d.direction = 'MAXIMIZE' THEN max(scores[1]) ELSE min(scores[1]) END
        FROM egolane_claims c WHERE c.study_id = s.study_id AND done > 0),
    (SELECT value_json FROM study_user_attributes a WHERE a.study_id = s.study_id
        AND key = 'objective')
FROM egolane_studies s JOIN studies USING (study_id)
    JOIN study_directions d ON d.study_id = s.study_id AND d.objective = 0
ORDER BY job, kind <> 'all', s.study_id
"""


def list_studies(link: Link) -> list[Listed]:
    """Every study of the storage, those of a job together."""
    require_tables(link)
    rows: list[Any] = link.once(lambda connection: connection.execute(_LIST).fetchall())
    lines: list[Any] = [
        (*row[:6], float(row[6]) or None, *row[7:9], json.loads(row[9])[0]) for row in rows
    ]
    return [Listed(*line) for line in lines]


@dataclass(frozen=True)
class Account:
    """What became of a job's trials, counted from the trials themselves. retried: tried again for
    one that was lost; counted_twice: finished although a retry of them is finished too."""

    asked: int
    finished: int
    running: int
    lost: int
    retried: int
    counted_twice: int

    def line(self) -> str:
        """In words."""
        return (
            f"{self.asked} asked, {self.finished} finished, {self.running} running,"
            f" {self.lost} lost with their workers, {self.retried} tried again,"
            f" {self.counted_twice} counted twice"
        )


_ACCOUNT = """
WITH mine AS (
    SELECT t.*, c.retry_of FROM trials t JOIN egolane_studies s USING (study_id)
        LEFT JOIN egolane_claims c USING (trial_id) WHERE s.job = %(job)s)
SELECT (SELECT sum(asked)::int FROM egolane_studies WHERE job = %(job)s),
    count(*) FILTER (WHERE state = 'COMPLETE'), count(*) FILTER (WHERE state = 'RUNNING'),
    count(*) FILTER (WHERE state = 'FAIL'), count(*) FILTER (WHERE retry_of IS NOT NULL),
    (SELECT count(*) FROM mine a JOIN mine b ON b.study_id = a.study_id
        AND b.retry_of = a.number AND a.state = 'COMPLETE' AND b.state = 'COMPLETE')
FROM mine
"""


def account(link: Link, job: str) -> Account:
    """The account of a job."""
    row = link.steady(lambda c: c.execute(_ACCOUNT, {"job": job}).fetchone())
    assert row is not None
    return Account(*row)


def progress_of(
    link: Link, studies: Sequence[int], seen: Mapping[int, int]
) -> dict[int, tuple[int, int, float | None, float | None]]:
    """Per study: finished, asked, and the smallest and largest first score of the trials that
    were finished since `seen` of them were."""
    rows = link.steady(
        lambda c: c.execute(
            "SELECT s.study_id, finished, asked, min(scores[1]), max(scores[1])"
            " FROM egolane_studies s JOIN unnest(%s::int[], %s::int[]) AS g(study_id, seen)"
            " USING (study_id) LEFT JOIN egolane_claims c ON c.study_id = s.study_id"
            " AND done > g.seen GROUP BY s.study_id",
            [list(studies), [seen.get(study, 0) for study in studies]],
        ).fetchall()
    )
    return {row[0]: row[1:] for row in rows}


_TRIALS = """
SELECT c.number, t.state::text, t.datetime_start, t.datetime_complete, c.point, c.scores,
    c.worker, c.retry_of
FROM egolane_claims c JOIN trials t USING (trial_id)
WHERE c.study_id = %s ORDER BY c.number
"""


def read_trials(link: Link, study_id: int, space: SearchSpace) -> list[FrozenTrial]:
    """The trials of a study that are finished or were lost, in order."""
    return frozen_trials(link, study_id, distributions(space))


def frozen_trials(link: Link, study_id: int, ranges: Mapping[str, Any]) -> list[FrozenTrial]:
    """As `read_trials`; ranges: Optuna's, in the order of the space."""
    from optuna.trial import TrialState, create_trial

    rows = link.steady(lambda c: c.execute(_TRIALS, [study_id]).fetchall())
    found = []
    for number, state, start, end, point, scores, worker, retry_of in rows:
        if state not in ("COMPLETE", "FAIL"):
            continue
        trial = create_trial(
            state=TrialState[state],
            values=scores if state == "COMPLETE" else None,
            params={
                key: r.to_external_repr(value)
                for (key, r), value in zip(ranges.items(), point, strict=True)
            },
            distributions=dict(ranges),
            user_attrs={
                "worker": worker,
                **({} if retry_of is None else {"retry_of": retry_of}),
            },
        )
        trial.number = number
        trial.datetime_start, trial.datetime_complete = _local(start), _local(end)
        found.append(trial)
    return found


def _local(moment: datetime | None) -> datetime | None:
    """A moment of the server, in UTC, as Optuna has it: local time."""
    return None if moment is None else moment.replace(tzinfo=UTC).astimezone().replace(tzinfo=None)
