"""Running one experiment on the drives of a fleet: `run_fleet` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.fleet import (
    FleetDrive,
    drive_experiment,
    plan_fleet,
    read_fleet,
    summary_rows,
    write_summary,
)
from egolane_pgm.report import shown
from egolane_pgm.report.fleet_table import fleet_table_rows
from egolane_pgm.running import OneOfSeveral, run_all
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import all_problems

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: The file in which a fleet's folder has a row for each drive.
SUMMARY = "summary.parquet"


class DriveTable:
    """What is told of the drives of a fleet.

    - rows: a row for each drive, see `egolane_pgm.fleet.summary_rows`.
    """

    rows: Sequence[Mapping[str, Any]]

    def __len__(self) -> int:
        return len(self.rows)

    def to_pandas(self) -> pd.DataFrame:
        """A row per drive; the index is `name`."""
        import pandas as pd

        return pd.DataFrame(self.rows).set_index("name")

    def plot(self) -> Figure:
        """Draw the accuracy of all drives and of those with each tag.

        Raises InputError for a fleet without scores.
        """
        from egolane_pgm.report.fleet_figure import fleet_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: fleet_figure(self.rows))


@dataclass(frozen=True, repr=False, eq=False)
class FleetResult(DriveTable):
    """What became of the drives of a fleet.

    - folder: with a result directory for each drive, and summary.parquet.
    - rows: of summary.parquet, see `egolane_pgm.fleet.summary_rows`.
    - were_there: how many drives had their result already.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     drives = Path(folder, "drives.csv")
    ...     rows = ["recording.seed,recording.frames,tag.road", '1,"[0, 90]",A4', '2,"[0, 90]",A2']
    ...     _ = drives.write_text("\\n".join(rows))
    ...     fleet = ego.run_fleet(place, drives, Path(folder, "out"))
    >>> fleet.to_pandas()[["tag.road", "frames"]].to_dict("index")["drive_1"]
    {'tag.road': 'A4', 'frames': 90}
    """

    folder: Path
    rows: Sequence[Mapping[str, Any]]
    were_there: int

    def __repr__(self) -> str:
        return f"FleetResult({self._title()})"

    def _title(self) -> str:
        return f"{len(self)} drives in {self.folder}, {len(self.failed)} failed"

    def _repr_html_(self) -> str:
        notes = [f"failed: {name}: {error}" for name, error in self.failed]
        return shown.html_table(self._title(), *fleet_table_rows(self.rows), notes)

    @property
    def failed(self) -> list[tuple[str, str]]:
        """The name of each drive that failed, and why."""
        return [(row["name"], row["error"]) for row in self.rows if row["error"] is not None]


def run_fleet(
    experiment: Given,
    fleet: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    overrides: Overrides = (),
    jobs: Jobs = 1,
    progress: bool | None = None,
) -> FleetResult:
    """Run an experiment on every drive of a table.

    - experiment: an experiment, or the path of its YAML file.
    - fleet: the table, see `egolane_pgm.fleet`.
    - out: the folder of the results, a directory for each drive, and of summary.parquet. Drives
      whose result is there already, from the same files, config and code, are not run again.
    - overrides: keys of the YAML that get other values, as `load_experiment` takes them.
    - jobs: processes that share the drives; or a Dask cluster, by the address of its scheduler, or
      `"local:4"` for one of four processes. All its machines see the recordings and `out`.
    - progress: whether a bar shows how far it is; None for in a terminal.

    A drive that fails does not stop the others; its row says why. Raises InputError for a table
    that does not fit, and where `out` cannot be written.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     drives = Path(folder, "drives.yaml")
    ...     _ = drives.write_text("drives: [{recording.seed: 3, recording.frames: [0, 90]}]")
    ...     first = ego.run_fleet(place, drives, Path(folder, "out"))
    ...     again = ego.run_fleet(place, drives, Path(folder, "out"))
    >>> len(first), first.were_there, again.were_there
    (1, 0, 1)
    """
    drives = read_fleet(os.fspath(fleet))
    folder = Path(out)
    plan = plan_fleet(load_experiment(experiment, overrides), drives, folder, overrides)
    done: list[OneOfSeveral] = []
    try:
        found = run_all(plan, jobs=jobs, resume=True)
        done.extend(bar(found, progress, total=len(plan), unit="drive"))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{len(done)} of {len(plan)} drives are in {folder}; the same command goes on"
        ) from None
    rows = summary_rows(drives, done)
    write_summary(folder / SUMMARY, rows)
    return FleetResult(folder, rows, sum(each.was_there for each in done))


def experiments_of(
    base: Experiment, fleet: str | os.PathLike[str], overrides: Overrides
) -> tuple[tuple[FleetDrive, ...], list[Experiment]]:
    """The drives of a table, and the experiment on each of them, to be learned or searched from.

    - overrides: keys that were overridden in the base.

    Raises InputError for all rows that do not fit.
    """
    drives = read_fleet(os.fspath(fleet))
    found = []
    with all_problems() as part:
        for drive in drives:
            with part():
                placed = drive_experiment(base, drive, overrides)
                # A drive may be what the base was tuned on, under another name too.
                found.append(placed.model_copy(update={"tuned_on": base.tuned_on}))
    return drives, found
