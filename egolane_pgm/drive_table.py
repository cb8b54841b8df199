"""A table of several drives: the runs of a list, the drives of a fleet, the runs of the paper."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.results import Result, is_result, read_result
from egolane_pgm.types import InputError, not_one_of
from egolane_pgm.views import shown
from egolane_pgm.views.tables import Table, page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class DriveTable:
    """Several drives, a row for each.

    - title: in one line.
    - rows: of each drive its name, `error` (why it failed, or None), and numbers by name, such as
      `model.accuracy`; see `egolane_pgm.fleet.summary_rows`.
    - parts: the tables and sentences that `to_text` prints.
    - document: what `--json` writes.
    - results: the results that are in memory, by name.
    - folder: where the result directories are, by name; None where they are in memory only.
    - notes: warnings, a line each.
    - learned: what was learned from the drives together, where something was.

    >>> import egolane_pgm as ego
    >>> short = {"recording.frames": [0, 300]}
    >>> one = ego.load_experiment("quickstart", short)
    >>> other = ego.load_experiment(one, {"name": "hard", "evidence_reading": "hard"})
    >>> runs = ego.run([one, other])
    >>> runs
    DriveTable('quickstart', 'hard')
    >>> runs["hard"]
    Result('hard': 300 frames, accuracy 0.788, detector 0.558; not tuned, causal)
    >>> runs.to_pandas()["model.accuracy"].round(3).to_dict()
    {'quickstart': 0.877, 'hard': 0.788}
    """

    title: str
    rows: Sequence[Mapping[str, Any]]
    parts: Sequence[str | Table]
    document: Mapping[str, Any]
    results: Mapping[str, Result] = field(default_factory=dict)
    folder: Path | None = None
    notes: tuple[str, ...] = ()
    learned: Any = None

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Result]:
        """The result of each drive that has one."""
        return (self[name] for name in self.names if self._has(name))

    def __getitem__(self, key: int | str) -> Result:
        """The result of a drive, by name or number. Raises InputError where there is none."""
        name = self.names[key] if isinstance(key, int) else key
        if name in self.results:
            return self.results[name]
        if self.folder is not None and self._has(name):
            return read_result(self.folder / name)
        raise InputError(f"drive: {not_one_of(name, [n for n in self.names if self._has(n)])}")

    def _has(self, name: str) -> bool:
        return name in self.results or (self.folder is not None and is_result(self.folder / name))

    @property
    def names(self) -> list[str]:
        """The name of each drive."""
        return [str(row["name"]) for row in self.rows]

    @property
    def failed(self) -> list[tuple[str, str]]:
        """The name of each drive that failed, and why."""
        return [(row["name"], row["error"]) for row in self.rows if row.get("error") is not None]

    def __repr__(self) -> str:
        return f"DriveTable({self.title})"

    def _repr_html_(self) -> str:
        tables = [part for part in self.parts if isinstance(part, Table)]
        notes = [f"failed: {name}: {error}" for name, error in self.failed]
        header, rows = (tables[0].header, tables[0].rows) if tables else ([], [])
        return shown.html_table(repr(self), header, rows, [*notes, *self.notes])

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """What a command prints: tables in a style of `report.tables.STYLES`.

        - wide: whether tables are whole; else none is wider than the terminal.
        """
        return page(self.parts, style, wide)

    def to_pandas(self) -> pd.DataFrame:
        """A row per drive; the index is `name`."""
        import pandas as pd

        return pd.DataFrame(self.rows).set_index("name")

    def plot(self) -> Figure:
        """Draw how far off the answers of the runs in memory are.

        Raises InputError for runs without scores.
        """
        from egolane_pgm.views.dispersion import dispersion_figure
        from egolane_pgm.views.style import inline_figure

        return inline_figure(lambda: dispersion_figure([*self.results.values()]))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write a result directory for each drive that is in memory, by its name.

        - figures: as in `Result.save`.

        Raises InputError where one cannot be written.
        """
        for name, result in self.results.items():
            result.save(Path(directory) / name, figures=figures)
        return Path(directory)
