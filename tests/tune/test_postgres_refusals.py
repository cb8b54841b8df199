"""Storages that cannot be used, each said in one line: not there, not ours, of another version."""

from __future__ import annotations

import socket
import time

import pytest

from egolane_pgm.tune import _connection
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.address import parse
from egolane_pgm.tune.postgres import find_job, list_studies
from egolane_pgm.tune.shared import run_shared
from egolane_pgm.types import InputError
from tests.kits.postgres_kit import (
    address_with_password,
    is_whole,
    make_job,
    rows,
)
from tests.kits.postgres_server import HOST, Server, free_port
from tests.kits.tuning_kit import bowl

pytest_plugins = ["tests.kits.postgres_fixtures"]


def refused(url: str) -> str:
    with pytest.raises(InputError) as caught:
        make_job(url, "drive")
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"storage {parse(url).shown}: ")
    return line


def test_a_storage_that_cannot_be_reached_is_one_line() -> None:
    begun = time.monotonic()
    line = refused(f"postgresql+psycopg://egolane@{HOST}:{free_port()}/postgres")
    assert "check the address, and that the server runs" in line
    assert time.monotonic() - begun < 5


def test_a_storage_that_does_not_answer_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_connection, "ANSWER_S", 0.5)
    with socket.create_server((HOST, 0)) as deaf:
        line = refused(f"postgresql+psycopg://egolane@{HOST}:{deaf.getsockname()[1]}/postgres")
    assert "timeout" in line or "no answer" in line


def test_a_wrong_password_and_none_are_one_line(server: Server, shared: str) -> None:
    url = address_with_password(shared)
    assert "check user and password" in refused(url.replace("s3cret", "guess"))
    host = shared.rpartition("@")[2]
    assert "check user and password" in refused(f"postgresql+psycopg://warden@{host}")


def test_a_database_that_is_not_there_is_one_line(server: Server) -> None:
    assert "create it" in refused(server.url("nowhere"))


def test_a_database_without_the_tables_is_one_line_and_gets_them_from_tune(
    server: Server, database: str
) -> None:
    link = Link(parse(database))
    with pytest.raises(InputError, match="has no tables of studies; start one"):
        list_studies(link)
    with pytest.raises(InputError, match="has no tables of studies; start one"):
        find_job(link, "drive")
    assert rows(server, database, "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'") == [
        (0,)
    ]
    run_shared(make_job(database, "drive", trials=10, evaluate=bowl), 1)
    is_whole(server, database, "drive", 10)
    link.close()


def test_a_user_who_may_not_make_tables_is_told_so(server: Server, database: str) -> None:
    server.execute("CREATE ROLE guest LOGIN")
    line = refused(database.replace("egolane@", "guest@"))
    assert "permission denied" in line
    assert "grant the user CREATE" in line


def test_an_older_schema_of_ours_is_refused_and_left_as_it_is(
    server: Server, database: str
) -> None:
    make_job(database, "drive")
    rows(server, database, "UPDATE egolane_schema SET version = 0")
    assert "egolane's schema 0, this egolane has 1" in refused(database)
    link = Link(parse(database))
    with pytest.raises(InputError, match="egolane's schema 0"):
        list_studies(link)
    link.close()


def test_an_older_schema_of_optuna_is_refused_and_left_as_it_is(
    server: Server, database: str
) -> None:
    make_job(database, "drive")
    rows(server, database, "UPDATE alembic_version SET version_num = 'v2.6.0.a'")
    line = refused(database)
    assert "schema v2.6.0.a" in line
    assert "optuna storage upgrade" in line
    rows(server, database, "DROP TABLE egolane_claims, egolane_studies, egolane_schema")
    assert "schema v2.6.0.a" in refused(database)
    rows(server, database, "DROP TABLE alembic_version")
    assert "before version 1" in refused(database)
