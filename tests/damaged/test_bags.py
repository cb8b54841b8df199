"""Bags with one byte changed: read as they were, read with a warning, or refused in one line."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines, write_lines
from egolane_pgm.types import InputError
from tests.kits.bags import plain_message, write_bag, write_bag2

N_FRAMES = 40


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    raw = [plain_message(k, [(True, False, 5, 1.0)], seq=k) for k in range(N_FRAMES)]
    bag = write_bag(
        folder / "a.bag", raw, stamps=[k * 10**8 for k in range(1, N_FRAMES + 1)], chunk_bytes=900
    )
    log = read_lines(bag)
    write_lines(folder / "a.mcap", log)
    (database,) = write_bag2(folder / "bag", log).glob("*.db3")
    return {path.suffix: path for path in (bag, folder / "a.mcap", database)}


@pytest.mark.parametrize("kind", [".bag", ".mcap", ".db3"])
def test_a_changed_byte_is_refused_in_one_line_or_loses_no_frame_without_a_word(
    bags: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    whole = bags[kind].read_bytes()
    damaged = tmp_path / f"a{kind}"
    refused = []
    for at in np.random.default_rng(0).choice(len(whole), 80, replace=False):
        damaged.write_bytes(whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :])
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                log = read_lines(damaged)
            except InputError as error:
                refused.append(str(error))
                continue
        assert len(log) == N_FRAMES or said, at
    assert len(refused) > 5
    assert all(line.startswith(f"{damaged}: ") for line in refused)
