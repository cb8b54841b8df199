"""A fleet: a table with a row for each drive, and one experiment that is run on all of them.

The table is a CSV or Parquet file, or a YAML with a list `drives`. Its columns, all of which may be
left out or left empty in a row:

- recording, ground_truth, camera: files, relative to the table. ground_truth `none`, or empty: the
  drive is not annotated.
- n_lanes, detector: as on the command line.
- name: of the drive's result directory; by default that of its recording.
- tag.NAME: what drives are grouped by, such as `tag.weather`.
- any other key of the experiment's YAML, such as `recording.seed` or `parameters.sigma1`.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import as_name, drive_key, name_of, with_recording
from egolane_pgm.experiment import Experiment, Overrides, load_experiment
from egolane_pgm.running import OneOfSeveral, plan_runs
from egolane_pgm.scoring.bootstrap import over_drives
from egolane_pgm.tools.files import read_parquet, read_text, read_yaml, write_parquet
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import InputError, problems_in, suggestion

#: The columns that are no keys of an experiment.
_OWN = ("name", "recording", "ground_truth", "camera", "detector", "n_lanes")

_FILES = ("recording", "ground_truth", "camera")

TAG = "tag."


@dataclass(frozen=True)
class FleetDrive:
    """A row of a fleet's table.

    - source: names the table and the row in messages.
    - name: of the drive's result directory.
    - cells: what the row says, by column, tags left out.
    - tags: its tags, by name without `tag.`.
    - folder: of the table.
    """

    source: str
    name: str
    cells: Mapping[str, Any]
    tags: Mapping[str, str]
    folder: Path


def read_fleet(path: str | Path) -> tuple[FleetDrive, ...]:
    """The drives of a table, in its order.

    Raises InputError for a file that cannot be read, a table without drives, a column that is
    nothing of an experiment, and for two drives of one name.
    """
    path = Path(path)
    rows = _rows(path)
    if not rows:
        raise InputError(f"{path}: has no drives; give it a row for each")
    for column in dict.fromkeys(column for row in rows for column in row):
        _check_column(path, column)
    given = [{k: v for k, v in row.items() if v is not None and v != ""} for row in rows]
    drives: dict[str, FleetDrive] = {}
    for number, (name, row) in enumerate(zip(_names(given), given, strict=True), 1):
        source = f"{path}: drive {number}"
        if name in drives:
            raise InputError(
                f"{source}: has the name '{name}', as {drives[name].source.split(': ')[-1]};"
                " give them a column `name`"
            )
        tags = {k.removeprefix(TAG): str(v) for k, v in row.items() if k.startswith(TAG)}
        cells = {k: v for k, v in row.items() if k != "name" and not k.startswith(TAG)}
        drives[name] = FleetDrive(source, name, cells, tags, path.parent)
    return tuple(drives.values())


def _rows(path: Path) -> list[dict[str, Any]]:
    ending = path.suffix.lower()
    if ending in (".yaml", ".yml"):
        content = read_yaml(path, "drives: [{recording: a.csv, n_lanes: 4}]")
        drives = content.pop("drives", None)
        if content:
            raise InputError(f"{path}: unknown key '{next(iter(content))}'; a fleet has `drives`")
        if not isinstance(drives, list) or not all(isinstance(row, dict) for row in drives):
            raise InputError(f"{path}: drives: needs a list, e.g. - {{recording: a.csv}}")
        return drives
    if ending == ".parquet":
        return list(read_parquet(path).to_pylist())
    if ending != ".csv":
        raise InputError(f"{path}: a fleet is a .csv, .parquet or .yaml file")
    return _csv_rows(path)


def _csv_rows(path: Path) -> list[dict[str, Any]]:
    import csv

    lines = csv.reader(read_text(path).splitlines())
    header = next(lines, [])
    rows = []
    for cells in lines:
        if not any(cells):
            continue
        if len(cells) != len(header):
            raise InputError(
                f"{path}: line {lines.line_num}: has {len(cells)} cells, the first line has"
                f" {len(header)}"
            )
        # A cell is YAML, but for what is text: a name may be 007, a tag `no`.
        rows.append(
            {
                column: cell
                if column in (*_FILES, "name", "detector") or column.startswith(TAG) or not cell
                else parse_yaml(cell, f"{path}: line {lines.line_num}: {column}")
                for column, cell in zip(header, cells, strict=True)
            }
        )
    return rows


def _check_column(path: Path, column: Any) -> None:
    known = (*_OWN, *Experiment.model_fields)
    if not isinstance(column, str) or not column:
        raise InputError(f"{path}: column {column!r} has no name")
    if column.startswith(TAG) or column in _OWN or column.split(".")[0] in Experiment.model_fields:
        return
    raise InputError(
        f"{path}: unknown column '{column}'{suggestion(column, known)}; what drives are grouped by"
        f" is a tag: {TAG}{column}"
    )


def _names(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The name of each drive: its own, else that of its recording, with that of the folder where
    several recordings are called so; without a recording its number."""
    stems = [name_of(str(row.get("recording", ""))) for row in rows]
    count = Counter(stems)
    names = []
    for number, (row, stem) in enumerate(zip(rows, stems, strict=True), 1):
        if "name" in row:
            names.append(as_name(str(row["name"])))
        elif "recording" not in row:
            names.append(f"drive_{number:0{len(str(len(rows)))}d}")
        elif count[stem] > 1:
            folder = Path(str(row["recording"])).absolute().parent.name
            names.append(as_name(f"{folder}_{stem}"))
        else:
            names.append(stem)
    return names


def drive_experiment(base: Experiment, drive: FleetDrive, overrides: Overrides = ()) -> Experiment:
    """The experiment on a drive of a fleet.

    - overrides: keys that were overridden in the base, see `with_recording`; the row goes before
      them.

    Raises InputError, naming table and row, for what does not fit.
    """
    cells = dict(drive.cells)
    given = {column: cells.pop(column, None) for column in _OWN[1:]}
    for column in _FILES:
        if given[column] is not None and (column, given[column]) != ("ground_truth", "none"):
            given[column] = str(drive.folder / str(given[column]))
    with problems_in(drive.source):
        if any(value is not None for value in given.values()):
            base = with_recording(
                base,
                given["recording"],
                given["ground_truth"],
                given["n_lanes"],
                given["camera"],
                given["detector"],
                overrides,
            )
        found = load_experiment(base, cells)
    return found.model_copy(update={"name": drive.name})


def plan_fleet(
    base: Experiment, drives: Sequence[FleetDrive], folder: Path, overrides: Overrides = ()
) -> list[OneOfSeveral]:
    """Plan a run for each drive, as `running.plan_runs` does; a drive that does not fit becomes a
    run that fails. overrides: as `drive_experiment`."""
    return plan_runs(
        [(drive.name, partial(drive_experiment, base, drive, overrides)) for drive in drives],
        folder,
    )


def experiments_of(
    base: Experiment, fleet: str | os.PathLike[str], overrides: Overrides
) -> tuple[tuple[FleetDrive, ...], list[Experiment]]:
    """The drives of a table, and the experiment on each of them, to be learned or searched from.

    - overrides: keys that were overridden in the base.

    Raises InputError for a row that does not fit.
    """
    drives = read_fleet(os.fspath(fleet))
    found = []
    for drive in drives:
        placed = drive_experiment(base, drive, overrides)
        # A drive may be what the base was tuned on, under another name too.
        found.append(placed.model_copy(update={"tuned_on": base.tuned_on}))
    return drives, found


def drives_of(drives: Sequence[FleetDrive], experiments: Sequence[Experiment]) -> list[str]:
    """Which drive each row of a fleet is of, by the name of its first row.

    - experiments: on each row. Raises InputError as `drive.drive_key`, naming the row.
    """
    keys = []
    for drive, experiment in zip(drives, experiments, strict=True):
        with problems_in(drive.source):
            keys.append(drive_key(experiment))
    return first_names([drive.name for drive in drives], keys)


def first_names(names: Sequence[str], keys: Sequence[str]) -> list[str]:
    """For each key the first name that it stands with."""
    first: dict[str, str] = {}
    return [first.setdefault(key, name) for name, key in zip(names, keys, strict=True)]


# --- the summary -------------------------------------------------------------------------------


def summary_rows(
    drives: Sequence[FleetDrive], done: Sequence[OneOfSeveral]
) -> list[dict[str, Any]]:
    """A row for each drive: its tags, which `drive` it is of (the name of its first row: those of
    several detectors are of one), whether it failed and why, the seconds that it took, and every
    number of scores.json by its keys with dots between them, such as `model.accuracy`.

    Matrices and the lanes over time stay in the result directory; of an interval the ends are
    `.low` and `.high`; `warnings` is how many there are.
    """
    names = [drive.name for drive in drives]
    keys = [run.drive or name for name, run in zip(names, done, strict=True)]
    drive_of = first_names(names, keys)
    rows = []
    for drive, first, run in zip(drives, drive_of, done, strict=True):
        kept = {"drive": first, "error": run.error, "seconds": run.seconds}
        if run.scores is not None:
            kept |= {"result": str(run.directory)}
        rows.append(drive_row(drive, kept, run.scores or {}))
    return rows


def drive_row(
    drive: FleetDrive, first: Mapping[str, Any], scores: Mapping[str, Any]
) -> dict[str, Any]:
    """The row of a drive: its name and tags, some columns, and every number of `scores`."""
    tags = {f"{TAG}{name}": value for name, value in drive.tags.items()}
    row = {"name": drive.name, **tags, **first}
    # The columns that are given stay first, and go before numbers of the same name.
    return row | numbers_of(scores) | row


def numbers_of(scores: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Every number of `scores`, by its keys with dots between them, after `prefix`."""
    found: dict[str, Any] = {}
    for key, value in scores.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found |= numbers_of(value, f"{name}.")
        elif name == "warnings":
            found[name] = len(value)
        elif prefix.endswith("intervals.") and value is not None:
            found |= {f"{name}.low": value[0], f"{name}.high": value[1]}
        elif not isinstance(value, (list, tuple)):
            found[name] = value
    return found


def write_summary(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write summary.parquet: a row per drive, columns of all. Raises InputError where it cannot be
    written."""
    import pyarrow as pa

    columns = dict.fromkeys(column for row in rows for column in row)
    arrays = {column: pa.array([row.get(column) for row in rows]) for column in columns}
    write_parquet(path, pa.table(arrays))


@dataclass(frozen=True)
class Pooled:
    """The accuracy of several drives together.

    - tag, value: which drives, "" for all of them.
    - drives, failed, scored: how many there are, how many failed, and how many have scores.
    - frames: that are scored.
    - accuracy, interval: of all scored frames together, with the interval of a bootstrap that
      draws whole drives, with all their rows; None without scores, and without an interval for
      fewer than two drives.
    - detector: the accuracy of the detector alone, or None.
    """

    tag: str
    value: str
    drives: int
    failed: int
    scored: int
    frames: int
    accuracy: float | None
    interval: tuple[float, float] | None
    detector: float | None


def pooled(rows: Sequence[Mapping[str, Any]]) -> list[Pooled]:
    """The accuracy of all drives of a summary, and of those with each value of each tag."""
    tags = [{key.removeprefix(TAG): row[key] for key in row if key.startswith(TAG)} for row in rows]
    return [_pool(tag, value, [rows[k] for k in which]) for tag, value, which in by_tag(tags)]


def by_tag(tags: Sequence[Mapping[str, str]]) -> list[tuple[str, str, list[int]]]:
    """Which of several drives are looked at together: all, under "" and "", then those with each
    value of each tag.

    - tags: of each drive.
    """
    found = [("", "", list(range(len(tags))))]
    for tag in dict.fromkeys(tag for mine in tags for tag in mine):
        for value in sorted({mine[tag] for mine in tags if tag in mine}):
            found.append((tag, value, [k for k, mine in enumerate(tags) if mine.get(tag) == value]))
    return found


def _pool(tag: str, value: str, rows: Sequence[Mapping[str, Any]]) -> Pooled:
    scored = [row for row in rows if row.get("model.accuracy") is not None]
    frames = np.array([row["frames_scored"] for row in scored], dtype=float)
    right = frames * np.array([row["model.accuracy"] for row in scored], dtype=float)
    accuracy = interval = None
    if scored:
        drive_of = [row["drive"] for row in scored]
        accuracy, interval = over_drives(np.stack([right, frames], axis=1), drive_of=drive_of)
    of_detector = [row.get("detector.accuracy") for row in scored]
    detector = None
    if scored and None not in of_detector:
        detector = float(np.dot(frames, np.array(of_detector, dtype=float)) / frames.sum())
    return Pooled(
        tag,
        value,
        len(rows),
        sum(row["error"] is not None for row in rows),
        len(scored),
        int(frames.sum()),
        accuracy,
        interval,
        detector,
    )
