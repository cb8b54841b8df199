"""The tables of studies in PostgreSQL: Optuna's, and three of our own that make the counts exact.

egolane_studies    one row per study, whose lock every claim takes: asked (trials in all), finished,
                   running, lost (with their workers), next_number; job and part: which studies
                   belong together; grace_s: after how long without a word a worker is dead
egolane_workers    one row per worker: seen is when it was last heard of, on the server's clock
egolane_claims     one row per trial: who has it, its point and scores as Optuna keeps them; done is
                   null while it runs, 0 when it was lost, else rises with each batch of results
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from egolane_pgm.tune._connection import Link, connect, explained, need_psycopg
from egolane_pgm.tune.address import Address
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import psycopg

#: Of our tables; and the revision of Optuna's that rows are written to directly.
SCHEMA, OPTUNA_SCHEMA = 1, "v3.2.0.a"

#: The advisory lock of whoever makes the tables.
_MAKING = 0x65676F6C616E65

_OURS = f"""
CREATE TABLE egolane_schema (version int NOT NULL);
INSERT INTO egolane_schema VALUES ({SCHEMA});
CREATE TABLE egolane_studies (
    study_id int PRIMARY KEY REFERENCES studies ON DELETE CASCADE,
    job text NOT NULL,
    part int NOT NULL,
    n_parts int NOT NULL,
    kind text NOT NULL,
    asked int NOT NULL,
    finished int NOT NULL DEFAULT 0,
    running int NOT NULL DEFAULT 0,
    lost int NOT NULL DEFAULT 0,
    next_number int NOT NULL DEFAULT 0,
    grace_s float8 NOT NULL,
    created timestamptz NOT NULL DEFAULT clock_timestamp()
);
CREATE INDEX ON egolane_studies (job);
CREATE TABLE egolane_workers (
    worker text PRIMARY KEY,
    job text NOT NULL,
    host text NOT NULL,
    pid int NOT NULL,
    started timestamptz NOT NULL DEFAULT clock_timestamp(),
    seen timestamptz NOT NULL DEFAULT clock_timestamp()
);
CREATE INDEX ON egolane_workers (job);
CREATE TABLE egolane_claims (
    trial_id int PRIMARY KEY REFERENCES trials ON DELETE CASCADE,
    study_id int NOT NULL REFERENCES egolane_studies ON DELETE CASCADE,
    number int NOT NULL,
    worker text NOT NULL,
    point float8[] NOT NULL,
    attrs jsonb,
    retry_of int,
    scores float8[],
    done int
);
CREATE INDEX ON egolane_claims (study_id, done);
"""

_STATE = """
SELECT to_regclass('studies') IS NOT NULL,
       to_regclass('egolane_schema') IS NOT NULL,
       to_regclass('alembic_version') IS NOT NULL
"""


def check_tables(link: Link) -> bool:
    """Whether the database has our tables, ready for use. Raises InputError where they, or
    Optuna's, are of another schema."""
    try:
        return link.once(lambda connection: _are_there(link.address, connection))
    except InputError:
        # Somebody may be making them at this moment, which is more than one transaction.
        return link.once(lambda connection: _are_there_in_the_end(link.address, connection))


def make_tables(link: Link) -> None:
    """Make whatever tables are missing; two that do this at once end up with one set. Raises
    InputError as `check_tables`, and where the user may not make tables."""
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    if check_tables(link):
        return
    psycopg = need_psycopg()
    address = link.address
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        # A connection of its own: who else makes them at this moment is waited for.
        with connect(address, 2 * link.answer_s) as connection:
            connection.execute("SELECT pg_advisory_lock(%s)", [_MAKING])
            if _are_there(address, connection):
                return
            url, options = address.engine_options()
            storage = optuna.storages.RDBStorage(url, engine_kwargs=options)
            storage.remove_session()
            storage.engine.dispose()
            _check_optuna(address, connection)
            with connection.transaction():
                connection.execute(_OURS)
    except SQLAlchemyError as error:
        cause = getattr(error, "orig", None) or error
        raise explained(address, cause) from None
    except (psycopg.Error, RuntimeError) as error:
        raise explained(address, error) from None


def _are_there_in_the_end(address: Address, connection: psycopg.Connection[Any]) -> bool:
    """`_are_there`, once whoever makes tables has made them."""
    connection.execute("SELECT pg_advisory_lock_shared(%s)", [_MAKING])
    try:
        return _are_there(address, connection)
    finally:
        connection.execute("SELECT pg_advisory_unlock_shared(%s)", [_MAKING])


def _are_there(address: Address, connection: psycopg.Connection[Any]) -> bool:
    has_optuna, has_ours, has_revision = connection.execute(_STATE).fetchone() or (False,) * 3
    if has_optuna and not has_revision:
        raise _older(address, "Optuna's tables there are from before version 1")
    if has_optuna:
        _check_optuna(address, connection)
    if not has_ours:
        return False
    row = connection.execute("SELECT max(version) FROM egolane_schema").fetchone()
    version = row[0] if row else None
    if version != SCHEMA or not has_optuna:
        raise InputError(
            f"storage {address.shown}: its tables are of egolane's schema {version}, this egolane"
            f" has {SCHEMA}; export the studies with the egolane that made them, or name another"
            " database"
        )
    return True


def _check_optuna(address: Address, connection: psycopg.Connection[Any]) -> None:
    row = connection.execute("SELECT max(version_num) FROM alembic_version").fetchone()
    revision = row[0] if row else None
    if revision != OPTUNA_SCHEMA:
        raise _older(address, f"Optuna's tables there have schema {revision}")


def _older(address: Address, what: str) -> InputError:
    return InputError(
        f"storage {address.shown}: {what}, this egolane writes {OPTUNA_SCHEMA}; upgrade them"
        " (`optuna storage upgrade --storage ...`), or name another database"
    )
