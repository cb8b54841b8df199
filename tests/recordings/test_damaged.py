"""Recordings that are cut off or damaged: refused in one line that names them, or read."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth, write_ground_truth
from egolane_pgm.recordings.topics import messages
from egolane_pgm.types import InputError
from tests.kits.bags import write_bag2
from tests.kits.drives import short_drive
from tests.kits.rosbag_writer import write_lines
from tests.kits.sensor_files import json_mcap

N_FRAMES = 40


def sqlite(path: Path) -> None:
    (database,) = write_bag2(path.with_suffix(""), short_drive(N_FRAMES).log).glob("*.db3")
    database.rename(path)


def lines(path: Path) -> None:
    write_lines(path, short_drive(N_FRAMES).log)


def truth(path: Path) -> None:
    write_ground_truth(path, short_drive(N_FRAMES).truth)


FILES: dict[str, tuple[Callable[[Path], None], Callable[[Path], Any]]] = {
    "a.csv": (lines, read_lines),
    "a.parquet": (lines, read_lines),
    "a.bag": (lines, read_lines),
    "a.mcap": (lines, read_lines),
    "a.db3": (sqlite, read_lines),
    "json.mcap": (json_mcap, lambda path: list(messages(path, "/lanes"))),
    "truth.txt": (truth, read_ground_truth),
}


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path: Path, name: str) -> None:
    make, read = FILES[name]
    make(tmp_path / name)
    whole, rng, refused = (tmp_path / name).read_bytes(), np.random.default_rng(0), []
    for k in range(16):
        damaged, at = bytearray(whole), int(rng.integers(len(whole)))
        if k % 2:
            del damaged[at:]
        damaged[at : at + 1] = bytes([whole[at] ^ 255])
        (tmp_path / name).write_bytes(damaged)
        with warnings.catch_warnings(record=True):
            try:
                read(tmp_path / name)
            except InputError as error:
                refused.append(str(error))
    assert refused
    assert all(line.startswith(f"{tmp_path / name}: ") and line.isprintable() for line in refused)
