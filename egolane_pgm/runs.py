"""Inputs of a run: experiments, lines, and tables of runs.

A table of runs is one experiment with a row of overrides per run. Its columns are keys of an
experiment (`recording.path`, `n_lanes`, `parameters.sigma1`) and the user's tags (`tag.driver`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from egolane_pgm.drives import DRIVE_KEYS, Drive, read_drives
from egolane_pgm.experiment import Experiment, make_experiment
from egolane_pgm.loading import (
    FILES,
    IN_MEMORY,
    ExperimentLike,
    Overrides,
    absolute,
    load_experiment,
    merge,
    nest,
    parse_overrides,
    safe_name,
)
from egolane_pgm.model import with_graph
from egolane_pgm.result import TAG, Result, stored
from egolane_pgm.running import noting, run_experiment
from egolane_pgm.tools.files import make_directory
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.tools.progress import bar
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.types import InputError, LineLog, suggestion

#: The experiment for lines without one; it needs no labels.
ZERO_LABEL = "zero_label"

#: The file of a folder of runs that has a row for each.
SUMMARY = "summary.parquet"


class Input(NamedTuple):
    """One run, ready to be read.

    - lines, truth: data in memory, None for files.
    - tags: labels to group runs by.
    """

    experiment: Experiment
    lines: Any = None
    truth: Any = None
    tags: Mapping[str, str] = {}

    def drives(self) -> list[Drive]:
        """The drives of the recording."""
        return read_drives(self.experiment, self.lines, self.truth, self.tags)


def open_input(
    given: Any,
    *,
    experiment: ExperimentLike | None = None,
    overrides: Overrides = None,
    n_lanes: int | None = None,
    ground_truth: Any = None,
    graph: Any = None,
    recording: Mapping[str, Any] | None = None,
) -> Input:
    """Open an experiment, or an experiment's model on lines.

    - given: an experiment (YAML file, name, dict, Experiment), a Result (its experiment on its
      recording), or lines (a file, a DataFrame or a LineLog).
    - experiment: the model for lines, `zero_label` if not given. Keys of the recording come from
      the other arguments.
    - graph: in place of the experiment's: a name, a file, a module or a network of pgmpy.
    - ground_truth: a file, a DataFrame with frame_id, lane and crossing, or "none".
    - recording: further keys of `recording`, such as `topic`.

    Raises InputError for anything else.
    """
    lines, truth = None, ground_truth
    if experiment is not None and not is_lines(given):
        raise InputError(f"experiment: goes with a recording of lines, which {given} is not")
    if isinstance(given, Result):
        found = given.experiment
        if found.recording.path == IN_MEMORY:
            [lines] = given.lines.values()
            truth = given.truth if truth is None else truth
        given = found
    of_recording = {key: value for key, value in (recording or {}).items() if value}
    options: dict[str, Any] = {"recording": of_recording} if of_recording else {}
    name = os.fspath(truth) if isinstance(truth, (str, os.PathLike)) else None
    if name is not None:
        options["ground_truth"] = None if name == "none" else {"path": name}
    changes = merge(options, parse_overrides(overrides))
    if lines is None and is_lines(given):
        lines, model = given, ZERO_LABEL if experiment is None else experiment
        loaded = load_experiment(model, changes, lines=lines, n_lanes=n_lanes)
    else:
        loaded = load_experiment(given, changes, n_lanes=n_lanes)
    if graph is not None:
        from egolane_pgm.studies.graph_file import graph_named

        loaded = with_graph(loaded, graph_named(graph, loaded))
    in_memory = None if isinstance(lines, (str, os.PathLike)) else lines
    # A file is in the experiment; "none" also drops the truth that a simulated drive has.
    return Input(loaded, in_memory, truth if name in (None, "none") else None)


def is_lines(given: Any) -> bool:
    """Whether something is a recording of lines rather than an experiment."""
    if isinstance(given, (LineLog, pd.DataFrame)):
        return True
    if not isinstance(given, (str, os.PathLike)):
        return False
    ending = Path(given).suffix.lower()
    return bool(ending or os.path.isdir(given)) and ending not in (".yaml", ".yml")


# --- tables of runs ------------------------------------------------------------------------------


def read_runs(table: str | os.PathLike[str] | pd.DataFrame) -> tuple[list[dict[str, Any]], Path]:
    """The rows of a table of runs, without empty cells, and the folder of its paths.

    - table: a DataFrame, or a CSV whose cells are YAML, except names, paths and tags.

    Raises InputError for an unknown column and for a table without rows.
    """
    if isinstance(table, pd.DataFrame):
        cells, folder, where = table, Path.cwd(), "table"
    else:
        cells, folder, where = _read_csv(Path(table)), Path(table).absolute().parent, str(table)
    for column in map(str, cells):
        if not column.startswith(TAG) and column.split(".")[0] not in Experiment.model_fields:
            hint = suggestion(column, Experiment.model_fields)
            raise InputError(f"{where}: unknown column '{column}'{hint}; a tag is {TAG}{column}")
    if cells.empty:
        raise InputError(f"{where}: has no rows; give it one for each run")
    # Whole numbers are floats in a column with empty cells; `convert_dtypes` makes them integers.
    objects = cells.convert_dtypes().astype(object)
    return [row.dropna().to_dict() for _, row in objects.iterrows()], folder


def _read_csv(path: Path) -> pd.DataFrame:
    try:
        cells = pd.read_csv(path, dtype=str, keep_default_na=False, na_values=[""])
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read as a table: {why}") from error
    for column in cells.columns.difference(["name", *FILES]):
        if not column.startswith(TAG):
            read = partial(parse_yaml, source=f"{path}: {column}")
            cells[column] = cells[column].astype(object).map(read, na_action="ignore")
    return cells


def table_inputs(
    experiment: ExperimentLike,
    table: str | os.PathLike[str] | pd.DataFrame,
    overrides: Overrides = None,
) -> list[Input]:
    """One run per row of a table of runs.

    A row with another `recording.path` keeps the reading options of the experiment (format, topic,
    columns) and drops the keys of the old drive: simulation, frames, ground truth, road. A row
    without `name` is named after its recording, or after the experiment and its row number.

    Raises InputError, naming the row, for a row that does not fit and for two of the same name.
    """
    base = load_experiment(experiment, overrides)
    rows, folder = read_runs(table)
    found: dict[str, Input] = {}
    for number, row in enumerate(rows, start=1):
        where = f"{base.source}: row {number}"
        tags = {key.removeprefix(TAG): str(v) for key, v in row.items() if key.startswith(TAG)}
        changes = absolute(nest({k: v for k, v in row.items() if not k.startswith(TAG)}), folder)
        content = base.model_dump(exclude_unset=True)
        name = f"{base.name}_{number}"
        if "path" in changes.get("recording", {}):
            content = {k: v for k, v in content.items() if k not in ("ground_truth", "road")}
            kept = {k: v for k, v in content["recording"].items() if k not in DRIVE_KEYS}
            content["recording"] = kept
            path = Path(changes["recording"]["path"])
            name = f"{path.parent.name}_{path.stem}"
            if content.get("tuned_on") == "same_frames" and str(path) != base.recording.path:
                content["tuned_on"] = "other_frames"
        name = safe_name(str(row.get("name", name)))
        if name in found:
            raise InputError(f"{where}: another row has the name {name}; add a column `name`")
        content = {**merge(content, changes), "name": name}
        found[name] = Input(make_experiment(content, where), tags=tags)
    return list(found.values())


def run_table(
    inputs: Sequence[Input],
    out: str | os.PathLike[str],
    *,
    n_blocks: int | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    progress: bool | None = False,
) -> pd.DataFrame:
    """Run each row of a table of runs; write a result directory for each.

    - out: folder of the results, and of summary.parquet.
    - n_blocks: hold out each of some blocks, see `studies.study.run_held_out`.
    - jobs, cluster: see `tools.jobs.parallel`.

    A row with an existing result of the same identity is not run again; a row that fails does not
    stop the others. Returns a row per run: name, tags, every number of its scores, seconds,
    `was_there`, `error`.
    """
    folder = Path(out)
    make_directory(folder)
    rows = parallel(partial(run_row, folder, n_blocks), inputs, jobs=jobs, cluster=cluster)
    done = list(bar(rows, progress, total=len(inputs), unit="run"))
    summary = pd.DataFrame(done).set_index("name")
    summary.to_parquet(folder / SUMMARY)
    return summary


def run_row(folder: Path, n_blocks: int | None, given: Input) -> dict[str, Any]:
    """Run one row of a table, unless its result exists; return its row of the summary."""
    name = given.experiment.name
    row: dict[str, Any] = {"name": name}
    row |= {f"{TAG}{key}": value for key, value in given.tags.items()}
    try:
        done = stored(given.experiment, folder / name, given.tags, n_blocks)
        row["was_there"] = done is not None
        if done is None:
            done = run_input(given, n_blocks=n_blocks)
            done.save(folder / name)
        return {**row, "seconds": done.run["seconds"], "error": None, **numbers(done.scores)}
    except InputError as error:
        return {**row, "error": str(error)}


def run_input(
    given: Input,
    *,
    n_blocks: int | None = None,
    chunk_frames: int | None = None,
    progress: bool | None = False,
) -> Result:
    """Run an experiment. n_blocks: hold out each of some blocks; chunk_frames: see `infer`."""
    if n_blocks is None:
        experiment, lines, truth, tags = given
        return run_experiment(
            experiment, lines, truth, chunk_frames=chunk_frames, tags=tags, progress=progress
        )
    # It can search: other runs do without Optuna.
    from egolane_pgm.studies.study import run_held_out

    with noting() as notes:
        drives = given.drives()
    return run_held_out(drives, n_blocks, notes=notes, progress=progress)


def numbers(scores: Mapping[str, Any]) -> dict[str, Any]:
    """Every single number of some scores, by its keys with dots between them."""
    found: dict[str, Any] = {}
    for key, value in pd.json_normalize(dict(scores)).iloc[0].items():
        if str(key).rpartition(".")[0].endswith("intervals"):
            if isinstance(value, list):
                found |= {f"{key}.low": value[0], f"{key}.high": value[1]}
        elif not isinstance(value, list):
            found[str(key)] = value
    return found
