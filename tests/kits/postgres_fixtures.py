"""The PostgreSQL server of the tests, a plugin of pytest for the modules that name it."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from tests.kits.postgres_kit import GUARDED, PASSWORD, end_all
from tests.kits.postgres_server import Server, find_binaries, memory

_names = itertools.count()


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    """A PostgreSQL server for all tests; they skip where the package is not installed."""
    if find_binaries() is None:
        pytest.skip("PostgreSQL: needs its server (Debian: apt-get install postgresql)")
    if os.name != "posix":
        pytest.skip("PostgreSQL: the tests start a server as POSIX systems do")
    with Server({GUARDED: PASSWORD}, folder=memory()) as made:
        yield made


@pytest.fixture(scope="session")
def shared(server: Server) -> str:
    """The address of a database that many tests share, each with its own studies."""
    return server.new_database("shared")


@pytest.fixture
def name() -> Iterator[str]:
    """A name that no study has."""
    yield f"study{next(_names)}"
    end_all()


@pytest.fixture
def database(server: Server) -> Iterator[str]:
    """The address of an empty database."""
    yield server.new_database(f"empty{next(_names)}")
    end_all()
