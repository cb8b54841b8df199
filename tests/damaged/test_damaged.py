"""What was damaged is read, or refused in one line that names the file."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from tests.damaged.readers import READERS
from tests.damaged.trying import whole_files, wrong_with_damage, wrong_with_seeds

#: Inputs of each reader that are drawn at random; `make fuzz` takes these and more.
TIMES = 25


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        roots = whole_files(name, tmp_path)
        assert wrong_with_damage(name, tmp_path, roots) == []
        assert wrong_with_seeds(name, tmp_path, roots, range(TIMES)) == []
