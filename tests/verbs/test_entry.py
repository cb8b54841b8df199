"""Ctrl-C, in a real process."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from tests.kits.drives import write_drive
from tests.kits.processes import started

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs signals")

#: An evidence rule that is never done.
SLOW = """
import time
from egolane_pgm.evidence.counting import *
def evidence(log, n_lanes, parameters):
    print("at work", flush=True)
    time.sleep(600)
"""


def test_ctrl_c_ends_a_command_with_one_line_and_130(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    drive = write_drive(tmp_path, evidence="./slow.py", fit="none")
    out = tmp_path / "place" / "out"
    running = started("run", drive, "--out", out)
    assert running.stdout is not None
    assert any(line == "at work\n" for line in running.stdout)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert said == (
        "egolane: interrupted; nothing was left half-written; the same command begins anew\n"
    )
    assert not list(tmp_path.glob("place/*"))
