"""The line that a process prints when it compiles its first kernel."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

#: Compiles a small kernel; the second call of it and the second kernel add nothing.
PROGRAM = """
import numpy as np
{before}
from egolane_pgm.inference.kernels import draws
index = np.zeros(2, dtype=np.int64)
paths = np.zeros((1, 2), dtype=np.int64)
for _ in range({calls}):
    draws.draw_forward(np.ones((1, 1)), np.ones((1, 1, 1)), index, np.zeros((1, 2)), paths)
print(paths.tolist())
"""
LINE = "compiling the kernels once, which takes some seconds\n"


def run_program(cache: Path, calls: int, before: str = "") -> tuple[str, str]:
    """Standard output and standard error of PROGRAM."""
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(before=before, calls=calls)],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), "NUMBA_DISABLE_JIT": "0"},
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout, ran.stderr


def test_the_first_compilation_of_all_is_announced_once_on_standard_error(tmp_path: Path) -> None:
    assert run_program(tmp_path, 0) == ("[[0, 0]]\n", "")
    assert run_program(tmp_path, 2) == ("[[0, 0]]\n", LINE)
    # The second process loads the kernel from the cache.
    assert run_program(tmp_path, 2) == ("[[0, 0]]\n", "")


@pytest.mark.parametrize(
    ("before", "calls"),
    [
        ("import numba; numba.njit(lambda: 0)()", 0),
        ("import sys, io; sys.stderr = io.StringIO()", 1),
        ("import multiprocessing; multiprocessing.process._parent_process = 1", 1),
    ],
    ids=["a user's own kernel", "redirected", "a worker"],
)
def test_nothing_else_is_announced(tmp_path: Path, before: str, calls: int) -> None:
    assert run_program(tmp_path, calls, before)[1] == ""
