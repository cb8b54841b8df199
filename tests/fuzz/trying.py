"""Tries a reader on damaged files, in a process of its own: what it may cost is limited there, and
what kills it is noticed."""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from time import thread_time
from typing import Any

from egolane_pgm.types import LONGEST, InputError
from tests.fuzz.damage import damaged

#: What reading a damaged file may cost: seconds of a processor, seconds in all (as long as the
#: process can still say something), and bytes of memory beyond those of whole files.
CPU_S, WALL_S, MEMORY = 10, 60, 1 << 30

REFUSED, ACCEPTED, WRONG = "refused", "accepted", "wrong"

#: What the process says when it is about to begin with the inputs of a reader.
_READY = "ready"

#: How often the memory of the process is looked at, seconds.
_LOOK_S = 0.05

#: A reader, and the seed of the damage.
Task = tuple[str, int]


@dataclass
class Tried:
    """What came of a reader: how many inputs were refused and accepted, and, by seed, what was
    wrong with the others."""

    reader: str
    counts: Counter[str] = field(default_factory=Counter)
    wrong: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0


def try_readers(names: Sequence[str], seeds: range, keep: Path | None) -> Iterator[Tried]:
    """Try each reader with each seed.

    - keep: a folder for what was read wrongly, below it READER-SEED; None keeps nothing.
    """
    tasks = [(name, seed) for name in names for seed in seeds]
    found = Tried(names[0])
    for (name, seed), verdict, seconds in _answers(tasks, keep):
        if name != found.reader:
            yield found
            found = Tried(name)
        found.seconds += seconds
        found.counts[verdict if verdict in (REFUSED, ACCEPTED) else WRONG] += 1
        if verdict not in (REFUSED, ACCEPTED):
            found.wrong[seed] = verdict
    yield found


def _answers(tasks: list[Task], keep: Path | None) -> Iterator[tuple[Task, str, float]]:
    """Each task with its verdict and its seconds. Where one ends the process, another one goes on
    with those that are left."""
    context = multiprocessing.get_context("spawn")
    while tasks:
        ours, theirs = context.Pipe(duplex=False)
        with tempfile.TemporaryDirectory(prefix="egolane-fuzz-") as folder:
            place = Path(folder)
            process = context.Process(target=_work, args=(tasks, place, keep, theirs))
            process.start()
            theirs.close()
            why = ""
            with contextlib.suppress(EOFError):
                # The first answer waits until everything is imported and compiled.
                before = None
                while tasks and not why:
                    if not ours.poll(_LOOK_S):
                        if before is not None and _resident(process.pid) > before + MEMORY:
                            why = f"needs more than {MEMORY >> 20} MB"
                            process.kill()
                        continue
                    verdict, seconds = ours.recv()
                    before = _resident(process.pid)
                    if verdict != _READY:
                        yield tasks.pop(0), verdict, seconds
            process.join()
            if tasks:
                task = tasks.pop(0)
                _keep(place / "input", keep, *task)
                said = (place / "output").read_text(errors="replace")
                why = why or (f"needs more than {WALL_S} s" if "Timeout" in said else "")
                why = why or f"ends the process, exit status {process.exitcode}"
                yield task, f"{why}: {' '.join(said.split())[-200:]}", 0.0


def _resident(process: int | None) -> int:
    """The memory of a process, bytes; 0 where it has ended."""
    with contextlib.suppress(OSError, IndexError):
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
        return pages * resource.getpagesize()
    return 0


def _keep(folder: Path, keep: Path | None, reader: str, seed: int) -> None:
    if keep is not None and folder.is_dir():
        place = keep / f"{reader.replace(' ', '_')}-{seed}"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(folder, place, symlinks=True)


# --- in the process ------------------------------------------------------------------------------


class _TooLong(BaseException):
    """More seconds of a processor than a damaged file may cost."""


def _raise_too_long(*_: Any) -> None:
    raise _TooLong


def _work(tasks: Sequence[Task], folder: Path, keep: Path | None, answers: Connection) -> None:
    # Libraries write about damaged files where nobody looks.
    output = os.open(folder / "output", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(output, stream)
    from tests.fuzz.readers import READERS

    warnings.simplefilter("ignore")
    signal.signal(signal.SIGPROF, _raise_too_long)
    for name, group in itertools.groupby(tasks, key=lambda task: task[0]):
        reader = next(each for each in READERS if each.name == name)
        whole = folder / name / "whole"
        whole.mkdir(parents=True)
        roots = [path.relative_to(whole) for path in reader.make(whole)]
        # Compiled, imported, loaded: what is left is what a file costs.
        for root in roots:
            shutil.copytree(whole, folder / "input", dirs_exist_ok=True)
            reader.read(folder / "input" / root)
        answers.send((_READY, 0.0))
        for _, seed in group:
            root = _damage(whole, folder / "input", roots, Random(f"{name} {seed}"))
            begun = thread_time()
            faulthandler.dump_traceback_later(WALL_S, exit=True)
            verdict = judge(reader.read, root)
            faulthandler.cancel_dump_traceback_later()
            if verdict not in (REFUSED, ACCEPTED):
                _keep(folder / "input", keep, name, seed)
            answers.send((verdict, thread_time() - begun))


def _damage(whole: Path, folder: Path, roots: Sequence[Path], rng: Random) -> Path:
    """Copy whole files into a folder, and damage one of them; returns what is to be read there."""
    shutil.rmtree(folder)
    shutil.copytree(whole, folder)
    root = folder / rng.choice(roots)
    file = rng.choice([path for path in sorted(root.rglob("*")) if path.is_file()] or [root])
    file.write_bytes(damaged(file, rng))
    return root


def judge(read: Any, path: Path) -> str:
    """What comes of reading a file: REFUSED, ACCEPTED, or what is wrong."""
    try:
        signal.setitimer(signal.ITIMER_PROF, CPU_S)
        try:
            read(path)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    except InputError as error:
        return _judge_refusal(error, path)
    except _TooLong as error:
        return f"takes more than {CPU_S} s of a processor{_where(error)}"
    except BaseException as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        return f"{said}{_where(error)}"
    return ACCEPTED


def _judge_refusal(error: InputError, path: Path) -> str:
    for line in error.lines:
        # It may be what the damaged one names: a file beside it, or their folder.
        if str(path.parent) not in line:
            return f"does not name the file: {line[:200]}{_where(error)}"
        if len(line) > LONGEST:
            return f"says {len(line)} letters: {line[:200]}{_where(error)}"
        if not line.isprintable():
            return f"says what cannot be printed: {line[:200]!a}{_where(error)}"
    return REFUSED


def _where(error: BaseException) -> str:
    """The last line of ours that an error came through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if f"{os.sep}egolane_pgm{os.sep}" in frame.filename]
    if not ours:
        return ""
    return f" ({Path(ours[-1].filename).name}, line {ours[-1].lineno})"
