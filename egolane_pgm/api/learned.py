"""Learning an experiment from its recording, or from the drives of a fleet: `learn`, `learn_fleet`
and what they return."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.api.fleets import DriveTable, experiments_of
from egolane_pgm.comparing.placing import parts_of_fleet
from egolane_pgm.drive import Drive, with_own_rate
from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.fleet import drive_row, drives_of, pooled
from egolane_pgm.learning import Learned, write_learned
from egolane_pgm.learning import learn as run_learn
from egolane_pgm.learning.fleet import SHARED, LearnedFleet
from egolane_pgm.learning.fleet import learn_fleet as learn_together
from egolane_pgm.learning.held_out import load_to_learn
from egolane_pgm.learning.tables import PREFIX
from egolane_pgm.model import Model, causality
from egolane_pgm.report import shown
from egolane_pgm.report.fleet_table import fleet_table_rows
from egolane_pgm.report.tables import score_rows, with_interval
from egolane_pgm.results import Result
from egolane_pgm.running import held_out_result
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class LearnResult:
    """What was learned from a recording, and what it is worth on frames that it has not seen.

    - experiment: what was learned from.
    - model: the experiment's, before.
    - blocks: how many blocks were held out in turn.
    - learned: what was learned.
    - held_out: each block believed with what was learned from the others.
    - notes: warnings, a line each.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> experiment = ego.load_experiment(place, {"recording.frames": [0, 600]})
    >>> learned = ego.learn(experiment, unlabelled=True, blocks=2)
    >>> learned  # doctest: +ELLIPSIS
    LearnResult('quickstart': 2 blocks, accuracy 0.880 ... -1.548 -> -1.393; held out, causal)
    >>> learned.held_out.to_pandas()["block"].nunique()
    2
    """

    experiment: Experiment
    model: Model
    blocks: int
    learned: Learned
    held_out: Result
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.experiment.name

    @property
    def parameters(self) -> dict[str, Any]:
        """What was learned, by name; tables as nested lists."""
        plain = {k: v for k, v in self.learned.parameters.items() if not k.startswith(PREFIX)}
        return {**plain, **self.learned.tables()}

    @property
    def scores(self) -> dict[str, Any] | None:
        """Held out, over the frames whose labels can be trusted; None where nothing is scored."""
        return None if self.learned.scores is None else dict(self.learned.scores)

    def __repr__(self) -> str:
        return f"LearnResult({self._title()})"

    def _title(self) -> str:
        parts = [f"{self.name!r}: {self.blocks} blocks"]
        if self.scores is not None:
            interval = self.scores["intervals"]["accuracy"]
            parts.append(f"accuracy {with_interval(self.scores['accuracy'], interval)}")
        if self.learned.log_evidence is not None:
            before, after = self.learned.log_evidence
            parts.append(f"log evidence per frame {before:.3f} -> {after:.3f}")
        return f"{', '.join(parts)}; {shown.how_tuned(self.held_out.run)}"

    def _repr_html_(self) -> str:
        header, rows = score_rows({} if self.scores is None else {"model": self.scores})
        return shown.html_table(self._title(), header, rows if self.scores else [], self.notes)

    def to_pandas(self) -> pd.DataFrame:
        """The frames as they were believed held out, with their `block`; see
        `Result.to_pandas`."""
        return self.held_out.to_pandas()

    def to_xarray(self) -> xr.Dataset:
        """The same as a data set; see `Result.to_xarray`."""
        return self.held_out.to_xarray()

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the beliefs held out as strips; see `Result.plot`."""
        return self.held_out.plot(first, last)

    def save(self, target: str | os.PathLike[str]) -> Path:
        """Write a new experiment with what was learned, and its graph where tables were learned.

        - target: its YAML file, or a folder for `learned_<name>.yaml`.

        Returns the YAML file. Raises InputError where it cannot be written.
        """
        return self.write(_yaml_at(target, self.name))[0]

    def write(self, target: Path) -> list[Path]:
        """As `save`; returns all files that were written."""
        return write_learned(self.experiment, self.model, self.learned.parameters, target)


@dataclass(frozen=True, repr=False, eq=False)
class FleetLearnResult(DriveTable):
    """What was learned from the drives of a fleet together, and what it is worth on drives that it
    has not seen.

    - experiment: what was learned from, on the drives' road.
    - source: what was learned from, in words.
    - held_out: what was left out in turn, in words.
    - rows: a row for each drive: its tags, the `drive` that it is of (the name of its first row),
      the `part` that it was left out with, from 1, its scores, held out, and `log_evidence.before`
      and `.held_out` learning, the mean of its frames.
    - learned: what was learned.
    - notes: warnings, a line each.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     drives = Path(folder, "drives.csv")
    ...     rows = ["recording.seed,recording.frames", *(f'{k},"[0, 300]"' for k in range(3))]
    ...     _ = drives.write_text("\\n".join(rows))
    ...     learned = ego.learn_fleet(place, drives, unlabelled=True)
    >>> learned.held_out
    '3 parts of the drives'
    >>> learned.to_pandas()["part"].to_list()
    [1, 2, 3]
    """

    experiment: Experiment
    source: str
    held_out: str
    rows: Sequence[Mapping[str, Any]]
    learned: LearnedFleet
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.experiment.name

    @property
    def parameters(self) -> dict[str, Any]:
        """What was learned, by name; tables as nested lists."""
        found = self.learned.parameters
        plain = {k: v for k, v in found.items() if not k.startswith(PREFIX)}
        return {**plain, **self.learned.tables()}

    def __repr__(self) -> str:
        return f"FleetLearnResult({self._title()})"

    def _title(self) -> str:
        parts = [f"{self.name!r}: {self.source}"]
        everything = pooled(self.rows)[0]
        if everything.accuracy is not None:
            parts.append(f"accuracy {with_interval(everything.accuracy, everything.interval)}")
        if self.learned.log_evidence is not None:
            before, after = self.learned.log_evidence
            parts.append(f"log evidence per frame {before:.3f} -> {after:.3f}")
        return f"{', '.join(parts)}; held out: {self.held_out}"

    def _repr_html_(self) -> str:
        return shown.html_table(self._title(), *fleet_table_rows(self.rows), self.notes)

    def save(self, target: str | os.PathLike[str]) -> Path:
        """As `LearnResult.save`."""
        return self.write(_yaml_at(target, self.name))[0]

    def write(self, target: Path) -> list[Path]:
        """As `save`; returns all files that were written."""
        found = self.learned
        return write_learned(self.experiment, found.model, found.parameters, target, self.source)


def _yaml_at(target: str | os.PathLike[str], name: str) -> Path:
    place = Path(target)
    if place.suffix in (".yaml", ".yml"):
        return place
    return place / f"learned_{name.removeprefix('learned_')}.yaml"


def learn(
    experiment: Given,
    *,
    overrides: Overrides = (),
    unlabelled: bool = False,
    blocks: int = 5,
    progress: bool | None = None,
) -> LearnResult:
    """Learn an experiment from its recording, and score it on frames that were held out.

    - experiment: an experiment, or the path of its YAML file.
    - overrides: keys of the YAML that get other values.
    - unlabelled: whether no label is looked at (`learning.labels: false`); for tables.
    - blocks: how many blocks are held out in turn.
    - progress: whether a bar shows how far it is; None for in a terminal.

    An evidence rule that can learn learns its parameters from the labels; with any other the tables
    of the graph are learned by EM. Raises InputError where nothing can be learned as the experiment
    says.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> experiment = ego.load_experiment(place, {"recording.frames": [0, 600]})
    >>> learned = ego.learn(experiment, blocks=2)
    >>> learned.scores["frames_scored"]
    518
    """
    given = with_own_rate(_load(experiment, overrides, unlabelled))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        drive = load_to_learn(given)
        with bar(None, progress, total=blocks + 1, unit="fit") as shows:
            learned = run_learn(given, recorded=drive.recorded, n_blocks=blocks, done=shows.update)
    # Several blocks may give the same warning.
    notes = tuple(dict.fromkeys(str(w.message) for w in caught))
    held_out = _held_out(drive, learned, blocks, notes)
    return LearnResult(given, learned.model, blocks, learned, held_out, notes)


def learn_fleet(
    experiment: Given,
    fleet: str | os.PathLike[str],
    *,
    overrides: Overrides = (),
    unlabelled: bool = False,
    blocks: int = 5,
    by_tag: str | None = None,
    jobs: Jobs = 1,
    progress: bool | None = None,
) -> FleetLearnResult:
    """Learn an experiment from the drives of a table together, and score it on drives that were
    held out.

    - experiment, overrides, unlabelled, progress: as in `learn`.
    - fleet: the table, see `egolane_pgm.fleet`.
    - blocks: how many parts of the drives are held out in turn; of one drive alone how many blocks.
    - by_tag: instead, the drives with each value of this tag are held out in turn.
    - jobs: processes that share the fits; or a Dask cluster, as `run_fleet` takes it.

    By EM the expected counts of the drives are added. Raises InputError for a table that does not
    fit, and where nothing can be learned as the experiment says.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     drives = Path(folder, "drives.yaml")
    ...     _ = drives.write_text("drives: [{recording.seed: 3, recording.frames: [0, 300]}]")
    ...     learned = ego.learn_fleet(place, drives, unlabelled=True, blocks=2)
    >>> learned.held_out
    '2 blocks of the one drive'
    """
    base = _load(experiment, overrides, unlabelled)
    drives, experiments = experiments_of(base, fleet, overrides)
    of = drives_of(drives, experiments)
    parts = parts_of_fleet(drives, of, blocks, by_tag)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        with bar(None, progress, total=1 + (len(parts) or blocks), unit="fit") as shows:
            learned = learn_together(
                experiments, parts, n_blocks=blocks, jobs=jobs, done=shows.update
            )
    part_of = {k: number for number, part in enumerate(parts, 1) for k in part}
    rows = []
    for k, drive in enumerate(drives):
        scores = learned.scores[k]
        before, after = learned.log_evidence_of[k] or (None, None)
        frames = 0 if scores is None else scores["frames_scored"]
        first = {"drive": of[k], "error": None, "part": part_of.get(k), "frames_scored": frames}
        told = {"model": scores or {}, "log_evidence": {"before": before, "held_out": after}}
        rows.append(drive_row(drive, first, told))
    held_out = f"{blocks} blocks of the one drive"
    if parts:
        held_out = f"{len(parts)} parts of the drives"
        held_out += f", by tag.{by_tag}" if by_tag is not None else ""
    return FleetLearnResult(
        base.model_copy(update={key: getattr(experiments[0], key) for key in SHARED}),
        f"{len(drives)} drives of {Path(fleet).name}",
        held_out,
        rows,
        learned,
        tuple(dict.fromkeys(str(w.message) for w in caught)),
    )


def _load(experiment: Given, overrides: Overrides, unlabelled: bool) -> Experiment:
    if isinstance(experiment, (list, tuple)):
        raise InputError("learn: takes one experiment; learn_fleet takes a table of drives")
    found = load_experiment(experiment, overrides)
    return load_experiment(found, {"learning.labels": False}) if unlabelled else found


def _held_out(drive: Drive, learned: Learned, blocks: int, notes: tuple[str, ...]) -> Result:
    """What was believed held out, as the result of a run."""
    run = {
        "blocks": blocks,
        "tuned_on": "other_frames",
        **causality(drive.experiment, drive.model, learned.held_out.parameters),
    }
    scores = {"name": drive.experiment.name, "fit": "learn", **run}
    scores |= {"frames": len(drive), "frames_scored": 0}
    if learned.scores is not None:
        scores |= {"model": learned.scores, "frames_scored": learned.scores["frames_scored"]}
    found = learned.held_out
    return held_out_result(
        drive, found.beliefs, found.block, fit="learn", notes=notes, run=run, scores=scores
    )
