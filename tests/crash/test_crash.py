"""Commands that are killed at a few of their calls; `make crash` kills at all of them."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.crash.points import why_not


@pytest.mark.skipif(bool(why_not()), reason=f"kills with strace: {why_not()}")
def test_what_a_killed_command_leaves_is_whole_and_the_same_command_goes_on() -> None:
    # In a process of its own: it forks, which a process with threads should not.
    commands = ["run", "tune", "convert .mcap", "compare"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.crash", *commands, "--few", "2"],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = re.findall(r"\| (.*) \| (\d+) \| (\d+) \| 0 \|", done.stdout)
    assert [name for name, *_ in rows] == commands
    assert all(int(n_killed) >= 2 for _, n_killed, _ in rows)
