"""Ctrl-C, in real processes: at the terminal (all processes are told) and to the command alone."""

from __future__ import annotations

import http.server
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.kits.drives import write_drive
from tests.kits.processes import ended, started
from tests.kits.synthetic_road import write_place

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs signals")

#: An evidence rule that is never done.
SLOW = """
import time
from egolane_pgm.evidence.counting import *
def evidence(*given, **named):
    time.sleep(600)
"""

#: A command that swallows an interruption, as libraries do, and goes on.
DEAF = """
import os, signal, time
import egolane_pgm.cli.main
def deaf(**_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(600)
    except BaseException:
        print("swallowed", flush=True)
    time.sleep(600)
egolane_pgm.cli.main.egolane = deaf
"""

#: A detector that is slow.
DETECTOR = """
import time
from egolane_pgm.detectors import ml
STEREO, PARAMETERS = False, ml.PARAMETERS
def start(camera, parameters):
    step = ml.start(camera, parameters)
    def look(picture):
        time.sleep(0.5)
        return step(picture)
    return look
"""


def slow_drives(folder: Path) -> list[Path]:
    (folder / "slow.py").write_text(SLOW)
    rule = str(folder / "slow.py")
    return [write_drive(folder / n, name=n, evidence=rule, fit="none") for n in ("a", "b", "c")]


#: Python's own start is not the command's: until it is imported, nothing can answer Ctrl-C. What
#: aborts is removed where Python takes itself down, which threads at work may not survive.
HELLO = """
import os
import egolane_pgm.cli.entry
kept = type("Aborts", (), {"__del__": lambda self: os.abort()})()
print("started", flush=True)
"""


def interrupt(
    words: list[object], seconds: float, out: Path, whole_group: bool, **environment: str
) -> None:
    """Interrupt `egolane words...` after some seconds: it ends at once, in one line, as a whole."""
    running = started(*words, first=HELLO, env={**os.environ, **environment})
    assert running.stdout is not None
    assert running.stdout.readline() == "started\n"
    time.sleep(seconds)
    assert running.poll() is None, running.communicate()
    began = time.perf_counter()
    (os.killpg if whole_group else os.kill)(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert time.perf_counter() - began < 30
    assert running.returncode == 130, said
    # A search says first what it searches and what it holds fixed.
    plan = r"^\d+ (numbers are searched|are held fixed): .*\n(  .*\n)*"
    said = re.sub(plan, "", said, flags=re.MULTILINE)
    assert said.count("\n") == 1
    assert said.startswith("egolane: interrupted; ")
    assert said.endswith("the same command begins anew\n") or "repeat the command to go on" in said
    # What the pool needed to be started ends a moment later.
    for _ in range(300):
        if not alive(running.pid):
            break
        time.sleep(0.1)
    assert not alive(running.pid)
    assert not list(out.parent.glob(".*"))


def alive(group: int) -> list[str]:
    """The states of the processes of a group that have not ended."""
    listed = subprocess.run(["ps", "-A", "-o", "pgid=,stat="], capture_output=True, text=True)
    states = [line.split() for line in listed.stdout.splitlines()]
    return [state for pgid, state in states if pgid == str(group) and state[0] != "Z"]


MOMENTS = pytest.mark.parametrize(
    ("seconds", "whole_group"), [(0.1, False), (0.6, True), (2.0, True), (4.0, False)]
)


@MOMENTS
def test_ctrl_c_ends_many_runs(tmp_path: Path, seconds: float, whole_group: bool) -> None:
    out = tmp_path / "place" / "out"
    words = ["run", *slow_drives(tmp_path), "--jobs", 2, "--out", out]
    interrupt(words, seconds, out, whole_group)


@MOMENTS
def test_ctrl_c_ends_a_comparison(tmp_path: Path, seconds: float, whole_group: bool) -> None:
    out = tmp_path / "place" / "out"
    words = ["compare", *slow_drives(tmp_path), "--jobs", 2, "--out", out]
    interrupt(words, seconds, out, whole_group)


def test_ctrl_c_that_is_swallowed_comes_again() -> None:
    done = ended("run", first=DEAF)
    assert (done.returncode, done.stdout) == (130, "swallowed\n")
    assert done.stderr == "egolane: interrupted; the same command begins anew\n"


@pytest.mark.parametrize("seconds", [1.5, 2.5])
def test_ctrl_c_ends_a_compiler(tmp_path: Path, seconds: float) -> None:
    out = tmp_path / "place" / "out"
    words = ["run", write_drive(tmp_path), "--out", out]
    interrupt(words, seconds, out, False, NUMBA_CACHE_DIR=str(tmp_path / "cache"))


@MOMENTS
def test_ctrl_c_ends_a_detector(tmp_path: Path, seconds: float, whole_group: bool) -> None:
    drive = write_place(tmp_path, 16)
    (tmp_path / "slow.py").write_text(DETECTOR)
    out = tmp_path / "place" / "lines.csv"
    out.parent.mkdir()
    words = ["detect", drive / "drive.avi", "--camera", drive / "cam.yaml", "-o", out]
    interrupt([*words, "--detector", tmp_path / "slow.py"], seconds, out, whole_group)


class SlowMirror(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", "1000000")
        self.end_headers()
        for _ in range(1000):
            try:
                self.wfile.write(bytes(1000))
            except OSError:
                return
            time.sleep(0.1)

    def log_message(self, *args: object) -> None:
        pass


def test_ctrl_c_ends_downloads_and_leaves_nothing_of_them(tmp_path: Path) -> None:
    mirror = http.server.ThreadingHTTPServer(("127.0.0.1", 0), SlowMirror)
    threading.Thread(target=mirror.serve_forever, kwargs={"poll_interval": 0.01}).start()
    out = tmp_path / "rle" / "a.bag"
    url = f"http://127.0.0.1:{mirror.server_address[1]}"
    words = ["data", "fetch", "--base-url", url, "--folder", tmp_path]
    try:
        interrupt(words, 3.0, out, True, NO_PROXY="127.0.0.1", no_proxy="127.0.0.1")
    finally:
        mirror.shutdown()
        mirror.server_close()
    assert not list(out.parent.glob("*"))


@pytest.mark.parametrize(("seconds", "whole_group"), [(0.2, True), (0.9, False)])
def test_ctrl_c_ends_the_reproduction(
    recordings: Path, tmp_path: Path, seconds: float, whole_group: bool
) -> None:
    out = tmp_path / "place" / "out"
    interrupt(["reproduce", "--out", out], seconds, out, whole_group)


@MOMENTS
def test_ctrl_c_ends_a_search(tmp_path: Path, seconds: float, whole_group: bool) -> None:
    drives = [write_drive(tmp_path / name, name=name) for name in ("a", "b")]
    out = tmp_path / "place" / "out"
    words = ["tune", *drives, "--trials", 1_000_000, "--jobs", 2, "--in-sample-only", "--out", out]
    interrupt(words, seconds, out, whole_group)


def test_ctrl_c_no_longer_ends_what_is_done() -> None:
    # Python removes this after it has given up its own handlers of signals.
    interrupts = "type('Last', (), {'__del__': lambda self: os.kill(os.getpid(), signal.SIGINT)})()"
    first = f"import os, signal\nkept = {interrupts}"
    done = ended("--version", first=first)
    assert (done.returncode, done.stderr) == (0, "")
