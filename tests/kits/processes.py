"""The command line in a process of its own, for signals, pipes and environments."""

from __future__ import annotations

import subprocess
import sys
from typing import Any


def started(*words: object, first: str = "", **options: Any) -> subprocess.Popen[str]:
    """`egolane words...` begun. first: Python that runs before it; options: of Popen."""
    # What a shell runs in the background, perhaps these tests, ignores Ctrl-C, and so would this.
    hears = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{hears}\n{first}\nfrom egolane_pgm.command import main\nmain()"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, words)],
        **{**pipes, "text": True, "start_new_session": True, **options},
    )
