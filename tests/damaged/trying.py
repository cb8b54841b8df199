"""Tries a reader on damaged files."""

from __future__ import annotations

import os
import shutil
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from random import Random

from egolane_pgm.types import LONGEST, InputError
from tests.damaged.damage import damaged, damages_of
from tests.damaged.readers import READERS


def whole_files(name: str, folder: Path) -> list[Path]:
    """Write a reader's whole files into `folder`/whole and read them. Returns what is read, as
    paths in there."""
    whole = folder / "whole"
    whole.mkdir()
    roots = [path.relative_to(whole) for path in READERS[name].make(whole)]
    for root in roots:
        READERS[name].read(whole / root)
    return roots


def wrong_with_damage(name: str, folder: Path, roots: Sequence[Path]) -> list[str]:
    """What comes of each file with each common damage, where that is wrong."""
    found = []
    for root in roots:
        for file in _files(folder / "whole" / root):
            for damage, content in damages_of(file.read_bytes()).items():
                problem = _problem(READERS[name].read, folder, root, file, content)
                found += [f"{file.name} {damage}: {problem}"] if problem else []
    return found


def wrong_with_seeds(
    name: str, folder: Path, roots: Sequence[Path], seeds: Iterable[int]
) -> list[str]:
    """What comes of files that are damaged at random, where that is wrong; what was read stays in
    `folder`/wrong-SEED."""
    return list(_wrong_with_seeds(name, folder, roots, seeds))


def _wrong_with_seeds(
    name: str, folder: Path, roots: Sequence[Path], seeds: Iterable[int]
) -> Iterator[str]:
    for seed in seeds:
        rng = Random(f"{name} {seed}")
        root = rng.choice(roots)
        file = rng.choice(_files(folder / "whole" / root))
        problem = _problem(READERS[name].read, folder, root, file, damaged(file, rng))
        if problem:
            shutil.copytree(folder / "input", folder / f"wrong-{seed}", dirs_exist_ok=True)
            yield f"seed {seed}, {file.name}: {problem}"


def _files(root: Path) -> list[Path]:
    return sorted(p for p in root.rglob("*") if p.is_file()) if root.is_dir() else [root]


def _problem(
    read: Callable[[Path], object], folder: Path, root: Path, file: Path, content: bytes
) -> str:
    """What is wrong with how a file is read whose place has this content; empty where nothing is:
    it was read, or refused in a line that can be printed and names it."""
    place = folder / "input"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder / "whole", place)
    (place / file.relative_to(folder / "whole")).write_bytes(content)
    try:
        read(place / root)
    except InputError as error:
        # It may be what the damaged one names: a file beside it, or their folder.
        said = str(error)
        if str(place) not in said or len(said) > LONGEST or not said.isprintable():
            return f"says {said[:200]!a}{_where(error)}"
    except Exception as error:
        return " ".join(f"{type(error).__name__}: {error}".split())[:200] + _where(error)
    return ""


def _where(error: BaseException) -> str:
    """The last line of ours that an error came through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if f"{os.sep}egolane_pgm{os.sep}" in frame.filename]
    return f" ({Path(ours[-1].filename).name}, line {ours[-1].lineno})" if ours else ""
