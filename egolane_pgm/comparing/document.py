"""The file of a comparison that has its numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from egolane_pgm.results import read_json, refusing_damage
from egolane_pgm.types import InputError

#: The file of a comparison's directory that has the numbers.
DOCUMENT = "comparison.json"


def folder_of(title: str) -> str:
    """A recording's title as the name of a directory."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", title).strip("._-") or "recording"


def read_document(file: Path) -> dict[str, Any]:
    """The content of comparison.json. Raises InputError for a file that is not one."""
    with refusing_damage(file, "; compare again"):
        content = read_json(file)
        if not content["recordings"]:
            raise InputError(f"{file}: recordings: is empty")
    return content
