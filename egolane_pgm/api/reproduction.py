"""Repeating the paper's runs: `reproduce` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.paper import (
    SCORES,
    Runs,
    load_published,
    parse_runs,
    reproduce_json,
    reproduce_run,
)
from egolane_pgm.report import shown
from egolane_pgm.report.tables import reproduction_rows
from egolane_pgm.results import Result
from egolane_pgm.tools.progress import bar

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class ReproduceResult:
    """Runs of the paper beside its published tables.

    - document: what `egolane reproduce --json` writes: per run the frames off and every score.
    - runs: the result of each run, by its number.

    >>> import egolane_pgm as ego
    >>> ego.reproduce(runs=[3, 4])  # doctest: +SKIP
    ReproduceResult(runs 3, 4: 0 of 31084 classified frames off; recovered parameters, in-sample)
    """

    document: Mapping[str, Any]
    runs: Mapping[int, Result]

    def __repr__(self) -> str:
        return f"ReproduceResult({self._title()})"

    @property
    def n_classified(self) -> int:
        """How many frames were classified: those of the detector and those of the model."""
        return sum(2 * int(entry["frames_scored"]) for entry in self.document["runs"])

    def _title(self) -> str:
        runs = ", ".join(map(str, self.runs))
        return (
            f"runs {runs}: {self.document['total_frames_off']} of {self.n_classified} classified"
            f" frames off; {self.document['parameters']} parameters, in-sample"
        )

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows of the table that the command prints."""
        return reproduction_rows(self.document, load_published())

    def _repr_html_(self) -> str:
        return shown.html_table(self._title(), *self.rows())

    def to_pandas(self) -> pd.DataFrame:
        """A row per run, matrix (`detector`, `model`) and score: `ours`, the `paper`'s, printed
        with two digits, and `difference`; `frames_off` is that of the matrix."""
        import pandas as pd

        published = load_published()
        rows = [
            (entry["run"], kind, score, entry[kind][score], printed[score], off)
            for entry in self.document["runs"]
            for kind, theirs in (("detector", "detector_only"), ("model", "model"))
            for printed in [published[entry["run"]][theirs]["metrics"]]
            for off in [entry[f"{kind}_frames_off"]]
            for score in SCORES
        ]
        names = ["run", "matrix", "score", "ours", "paper", "frames_off"]
        frame = pd.DataFrame(rows, columns=names).set_index(names[:3])
        frame.insert(2, "difference", frame["ours"] - frame["paper"])
        return frame

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    def plot(self) -> Figure:
        """Draw how far off the answers of detector and model are in each run."""
        from egolane_pgm.report.dispersion import dispersion_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: dispersion_figure([*self.runs.values()]))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = False) -> Path:
        """Write a result directory for each run into `directory`, by its name. Raises InputError
        where one cannot be written."""
        for run in self.runs.values():
            run.save(Path(directory) / run.name, figures=figures)
        return Path(directory)


def reproduce(
    *,
    runs: Runs = "1-10",
    parameters: str = "recovered",
    out: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> ReproduceResult:
    """Repeat runs of the paper, beside its published tables. The recordings are needed.

    - runs: a number from 1 to 10, several, or text such as "1-5,7".
    - parameters: "recovered" (by a search inside the truncation; run 5 from the authors' code), or
      "published" (as printed, truncated).
    - out: a folder in which the result directory of each run is written as soon as it is done.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Raises InputError for a run that the paper does not have, and where a recording is missing.

    >>> import egolane_pgm as ego
    >>> ego.reproduce(runs=[1, 11])
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: run 11: the paper has runs 1 to 10
    """
    found: dict[int, Result] = {}
    done = []
    for number in bar(parse_runs(runs), progress, desc="runs", unit="run"):
        result = reproduce_run(number, parameters)
        done.append(result)
        found[number] = result.run
        if out is not None:
            found[number].save(Path(out) / found[number].name, figures=False)
    return ReproduceResult(reproduce_json(done, parameters), found)
