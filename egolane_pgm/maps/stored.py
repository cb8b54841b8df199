"""The Parquet files of maps, lane graphs and road tables, whose metadata name kind and licence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from egolane_pgm.tools.files import read_parquet
from egolane_pgm.types import InputError

ATTRIBUTION = "© OpenStreetMap contributors, ODbL"


def check_path(path: str | Path, what: str) -> None:
    """Raise InputError for the name of a file that is none for `what`, such as "lane graph"."""
    if Path(path).suffix.lower() != ".parquet":
        raise InputError(f"{path}: a {what} is a .parquet file")


def marks(what: str, version: str) -> dict[str, str]:
    """The metadata of a file."""
    return {_key(what): version, "attribution": ATTRIBUTION}


def read_stored(path: str | Path, what: str, version: str, command: str = "") -> Any:
    """Read a pyarrow table with the marks of `what` and `version`.

    - command: writes such a file, if one does.

    Raises InputError for a file that cannot be read, that is something else, or of another version.
    """
    table = read_parquet(Path(path))
    found = (table.schema.metadata or {}).get(_key(what).encode(), b"").decode()
    if found != version:
        wrong = f"version {found}, not {version}" if found else f"no {what}"
        cure = f"; `{command} -o {path}` writes one" if command else ""
        raise InputError(f"{path}: {wrong}{cure}")
    return table


def _key(what: str) -> str:
    return f"egolane_{what.replace(' ', '_')}"
