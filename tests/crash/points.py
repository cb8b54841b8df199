"""The calls to the system with which a command changes files, and a kill -9 at one of them.

strace lists the calls and kills: it sees those of libraries in C++ and of SQLite too. A command is
a fork of this process, which has imported everything: most tries take a fraction of a second.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Calls that change files, under the names that systems have for them.
CALLS = (
    *("openat", "open", "creat", "write", "pwrite64", "writev", "copy_file_range", "sendfile"),
    *("ftruncate", "fsync", "fdatasync", "rename", "renameat", "renameat2", "link", "linkat"),
    *("symlink", "symlinkat", "unlink", "unlinkat", "mkdir", "mkdirat", "rmdir"),
)

_PR_SET_PTRACER = 0x59616D61


@dataclass(frozen=True)
class Call:
    """The `number`-th call (from 1) of a name in a process; text: as strace prints it."""

    name: str
    number: int
    text: str


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, negative for a signal; the calls that changed files in a
    folder; what it printed."""

    code: int
    calls: Sequence[Call]
    said: str


def attempt(
    work: Callable[[], Any], folder: Path | None = None, kill_at: Call | None = None
) -> Ended:
    """Do work in a fork of this process.

    - folder: calls that change something below it are listed; None: nothing is listed.
    - kill_at: the call before which the process is killed.
    """
    with tempfile.TemporaryDirectory() as place:
        said, log = Path(place) / "said", Path(place) / "log"
        ours, theirs = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(theirs)
            _work(work, ours, said)
        os.close(ours)
        tracer = None if folder is None else _attached(pid, log, kill_at)
        os.write(theirs, b"!")
        os.close(theirs)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if tracer is not None:
            tracer.wait()
        calls = [] if folder is None else _listed(log, folder, pid)
        return Ended(code, calls, said.read_text(errors="replace") if said.exists() else "")


def _work(work: Callable[[], Any], ready: int, said: Path) -> None:
    """What the fork does; does not return."""
    code = 1
    try:
        # Some systems let only an ancestor look on.
        ctypes.CDLL(None).prctl(_PR_SET_PTRACER, -1, 0, 0, 0)
        os.read(ready, 1)
        target = os.open(said, os.O_CREAT | os.O_WRONLY)
        os.dup2(target, 1)
        os.dup2(target, 2)
        try:
            work()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        import traceback

        os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(code)


def _attached(pid: int, log: Path, kill_at: Call | None) -> subprocess.Popen[str]:
    # Without a mark, a call that this machine's architecture lacks would be an error.
    words = ["strace", "-f", "-y", "-s", "0", "-o", str(log), "-p", str(pid)]
    words += ["-e", "trace=" + ",".join(f"?{name}" for name in CALLS)]
    if kill_at is not None:
        words += ["-e", f"inject={kill_at.name}:signal=SIGKILL:when={kill_at.number}"]
    tracer = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    assert tracer.stderr is not None
    said = tracer.stderr.readline()
    if "attached" not in said:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise OSError(f"strace cannot look on: {said.strip()}")
    return tracer


def _listed(log: Path, folder: Path, pid: int) -> list[Call]:
    """The calls of the process's own thread that change something below a folder."""
    counts: Counter[str] = Counter()
    calls = []
    for line in log.read_text(errors="replace").splitlines():
        match = re.match(r"(\d+) +(\w+)\(", line)
        if match is None or int(match[1]) != pid:
            continue
        name = match[2]
        counts[name] += 1
        is_read = name.startswith("open") and not re.search("O_WRONLY|O_RDWR|O_CREAT", line)
        if str(folder) in line and not is_read:
            calls.append(Call(name, counts[name], line.partition(" ")[2].strip()))
    return calls


@functools.cache
def why_not() -> str:
    """Why no call can be killed at on this system; "" where it can be done."""
    if sys.platform != "linux":
        return "needs Linux"
    if shutil.which("strace") is None:
        return "needs strace"
    try:
        done = attempt(lambda: time.sleep(0), Path("/nowhere"))
    except OSError as error:
        return str(error)
    return "" if done.code == 0 else f"strace: a process ended with {done.code}"
