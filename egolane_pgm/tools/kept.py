"""Tables that take long to make, kept as Parquet files by the checksum of what they depend on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from egolane_pgm.tools.files import make_directory, read_parquet, write_parquet
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd


def kept_tables(
    folder: Path | None,
    keys: Sequence[str],
    make: Callable[[list[int]], Iterator[pd.DataFrame]],
) -> Iterator[pd.DataFrame]:
    """Yield the table of each key, from its file or made and then written.

    - folder: of the files; None to keep nothing.
    - keys: checksums, the names of the files.
    - make: yields the tables of some keys, given as positions, in order.
    """
    if folder is not None:
        make_directory(folder)
    there = {k: _read(folder / f"{key}.parquet") for k, key in enumerate(keys) if folder}
    made = make([k for k in range(len(keys)) if there.get(k) is None])
    for k, key in enumerate(keys):
        table = there.get(k)
        if table is None:
            table = next(made)
            if folder is not None:
                write_parquet(folder / f"{key}.parquet", table)
        yield table


def _read(file: Path) -> pd.DataFrame | None:
    """The table in a file; None if it is missing or damaged."""
    try:
        return read_parquet(file)
    except InputError:
        return None
