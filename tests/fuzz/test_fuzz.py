"""`make fuzz`, shorter: what was damaged is read, or refused in one line that names the file."""

from __future__ import annotations

import pytest

from tests.fuzz.readers import READERS
from tests.fuzz.trying import Tried, try_readers

#: Inputs of each reader; `make fuzz` takes these and more.
TIMES = 100

NAMES = [reader.name for reader in READERS]


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Tried]:
    """All readers, in one process."""
    keep = tmp_path_factory.mktemp("wrong")
    return {each.reader: each for each in try_readers(NAMES, range(TIMES), keep)}


@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tried: dict[str, Tried]) -> None:
    assert tried[name].wrong == {}
    assert tried[name].counts.total() == TIMES
    assert tried[name].counts["refused"] > 0
