"""Damages a file: its bytes, its words, and the values in a YAML or JSON.

Everything is drawn from a `random.Random`, so that a seed gives the same damage again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import yaml

#: Words and values that users have put in the place of others.
WORDS = (
    *("", " ", "0", "-1", "1e3", "1e300", "nan", "inf", "1,5", "1000", "true", "null", "None", "~"),
    *("2020-01-01", "12:30", "a" * 300, "/tmp", "n_lanes", "½", "\t", "\x1b[31m", "&a", "[", "}"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, 0, 1, 2, -1, 51, 1000, 0.5, 1e300, float("nan"), float("inf"), "x", "", [], [0]),
    *([2, 1], [[1, 2], [3]], {}, {"a": 1}),
)

_BETWEEN = re.compile(rb"([\s,;:=<>\"'\[\]{}()|]+)")


def damages_of(content: bytes) -> dict[str, bytes]:
    """What happens to any file sooner or later."""
    middle = len(content) // 2
    return {
        "empty": b"",
        "cut in half": content[:middle],
        "without its end": content[:-7],
        "without its beginning": content[7:],
        "of another kind": b"a b\n1;2\n" * 20,
        "not text": bytes(range(256)),
        "zeros in the middle": content[:middle] + bytes(64) + content[middle + 64 :],
        "twice": content + content,
    }


def damaged(file: Path, rng: Random) -> bytes:
    """The content of a file, damaged in a way that suits its kind."""
    content = file.read_bytes()
    kinds: list[Callable[[bytes, Random], bytes]] = [_bytes, _words]
    if file.suffix in (".yaml", ".json", ".jsonl"):
        kinds += [_values] * 4
    try:
        return rng.choice(kinds)(content, rng)
    except (ValueError, yaml.YAMLError):
        # Not everything can be written in every format.
        return _bytes(content, rng)


def _bytes(content: bytes, rng: Random) -> bytes:
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 4))):
        # What a file is about mostly stands at its beginning.
        at = rng.randrange(rng.choice((len(data), min(len(data), 256))) + 1)
        size = rng.choice((1, 4, 64))
        how = rng.randrange(4)
        if how == 0:
            data[at : at + size] = rng.randbytes(size)
        elif how == 1:
            data[at:at] = rng.randbytes(size)
        elif how == 2:
            del data[at : at + size]
        else:
            del data[at:]
    return bytes(data)


def _words(content: bytes, rng: Random) -> bytes:
    """The words of a text replaced, left out or exchanged."""
    words = _BETWEEN.split(content)
    at, other = rng.randrange(len(words)), rng.randrange(len(words))
    words[at], words[other] = rng.choice(
        [(rng.choice(WORDS).encode(), words[other]), (words[other], words[at]), (b"", words[at])]
    )
    return b"".join(words)


def _values(content: bytes, rng: Random) -> bytes:
    """One value of a YAML or JSON, or of a line of JSON, replaced, left out or put in a list."""
    lines = content.splitlines() if content.startswith(b"{") else []
    if len(lines) > 1 and lines[1].startswith(b"{"):
        at = rng.randrange(len(lines))
        lines[at] = _values(lines[at], rng)
        return b"\n".join(lines) + b"\n"
    tree = yaml.safe_load(content)
    section, key = rng.choice(_places(tree))
    how = rng.randrange(4)
    if how < 2:
        section[key] = rng.choice(VALUES)
    elif how == 2:
        section[key] = [section[key]]
    else:
        del section[key]
    if content.startswith(b"{"):
        return json.dumps(tree, default=str).encode()
    return yaml.safe_dump(tree, sort_keys=False).encode()


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Each section of a tree of dicts and lists, with each of its keys."""
    found = []
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        found.append((tree, key))
        if isinstance(tree[key], (dict, list)):
            found += _places(tree[key])
    return found
