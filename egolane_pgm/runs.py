"""Runs of experiments, of lines, and of tables of runs.

A table of runs is one experiment with a row of overrides per run. Its columns are keys of an
experiment (`recording.path`, `n_lanes`, `parameters.sigma1`) and the user's tags (`tag.driver`).
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypedDict, Unpack, overload

import pandas as pd
from annotated_types import Ge

from egolane_pgm.drives import DRIVE_KEYS, Drive, check_sources, read_drives
from egolane_pgm.experiment import FROM_MAP, Experiment, FitSettings, make_experiment
from egolane_pgm.loading import (
    FILES,
    IN_MEMORY,
    ExperimentLike,
    Overrides,
    absolute,
    camera_beside,
    load_experiment,
    merge,
    nest,
    on_other_lines,
    parse_overrides,
    safe_name,
    with_camera,
)
from egolane_pgm.model import compile_model, with_graph
from egolane_pgm.recordings.columns import column_keys, plain
from egolane_pgm.result import TAG, Result, check_writable, stored
from egolane_pgm.running import noting, run_experiment
from egolane_pgm.tools import options
from egolane_pgm.tools.files import atomic, make_directory
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.tools.options import Option, StrPath, place_of
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


class RunOptions(TypedDict, total=False):
    """The options of `run` that do not change what it returns."""

    experiment: ExperimentLike | None
    overrides: Overrides
    ground_truth: options.Truth | None
    n_lanes: int | None
    camera: StrPath | None
    detector: StrPath | None
    columns: options.ColumnNames
    graph: options.Graph
    chunk_frames: int | None
    held_out: bool
    out: StrPath | None
    figures: bool
    jobs: int
    cluster: str | None


@overload
def run(
    given: Any, *, table: StrPath | pd.DataFrame, **options: Unpack[RunOptions]
) -> pd.DataFrame: ...


@overload
def run(
    given: Any,
    *,
    table: StrPath | pd.DataFrame | None = None,
    dry_run: Literal[True],
    **options: Unpack[RunOptions],
) -> str: ...


@overload
def run(given: Any, **options: Unpack[RunOptions]) -> Result: ...


def run(
    given: Annotated[ExperimentLike | options.Lines | Result, Option("EXPERIMENT|LINES")],
    *,
    experiment: Annotated[ExperimentLike | None, Option("X.yaml")] = None,
    overrides: options.Overrides = (),
    ground_truth: Annotated[options.Truth | None, Option("FILE|none")] = None,
    n_lanes: int | None = None,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    detector: Annotated[StrPath | None, Option("NAME|FILE.py")] = None,
    columns: options.ColumnNames = None,
    graph: options.Graph = None,
    table: options.TableOfRuns = None,
    chunk_frames: Annotated[int | None, Ge(1)] = None,
    held_out: bool = False,
    dry_run: bool = False,
    out: Annotated[StrPath | None, Option("DIR", default="results/*")] = None,
    figures: bool = True,
    jobs: options.Jobs = 1,
    cluster: options.Cluster = None,
) -> Result | pd.DataFrame | str:
    """Infer the lane in each frame of a recording, score it, and list lane changes.

    EXPERIMENT is a YAML file, or a name that `egolane show` lists. LINES is a recording of lines, a
    video or a folder of pictures, which is run with the model of an experiment.

    With a table the experiment is run once per row of overrides: a result directory for each, and
    summary.parquet. Rows that have a result already are skipped; a row that fails does not stop the
    others.

    - given: an experiment; lines: a file, a DataFrame (see `read_lines`) or a LineLog; or a Result
      or Study, whose (fitted) experiment is run again on its recording.
    - experiment: the model for LINES (evidence, graph, filter, parameters), by default zero_label.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0, recording.topic=/lanes.
    - ground_truth: annotated lanes, a file or a DataFrame with frame_id, lane and crossing; "none"
      to run without.
    - n_lanes: number of lanes of the road.
    - camera: camera of pictures, or of lines in pixels; by default PICTURES.camera.yaml, made from
      the pictures if it does not exist.
    - detector: line detector for a video or pictures, by default ml.
    - columns: names and units of a table's columns or of fields, e.g.
      offset_m=lateral,unit=cm,left_positive=true (docs/howto/csv.md).
    - graph: another graph: a name or a file; in Python also a module, a pgmpy network, or a result
      or study, whose graph is taken with its tables.
    - table: table of runs: columns are YAML keys (recording.path, parameters.sigma1) and tag.X.
    - chunk_frames: infer this many frames at a time, to save memory on long drives.
    - held_out: infer each block of the annotated frames with parameters that were fitted to the
      others (`fit.method`: none, learn, tune; `fit.folds`: number of blocks).
    - dry_run: check keys, plugins, parameters and files without a run. A .py that a YAML names is
      executed.
    - out: result directory; with a table, the folder of its results. A `*` in it is the run's name.
    - figures: draw the posterior over time.
    - jobs: processes that share the rows of a table.
    - cluster: Dask cluster for the rows of a table.

    Returns a `Result`; with a table a DataFrame with a row per run; of a dry run a line. Writes
    files only with `out`, and the camera of pictures that have none. Raises InputError if the
    arguments do not fit.

    >>> import egolane_pgm as ego
    >>> result = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> int(result.frames["Lane_2"].idxmax()) in result.frames.index
    True
    >>> figure = result.plot()
    >>> lines = ego.simulate("a4", frames=300).log.to_pandas()
    >>> ego.run(lines, n_lanes=4)
    Result('in_memory': 300 frames, no ground truth; not tuned, causal)
    """
    chosen = open_input(
        given,
        experiment=experiment,
        overrides=overrides,
        n_lanes=n_lanes,
        ground_truth=ground_truth,
        graph=graph,
        recording={
            "camera": camera,
            "detector": detector,
            "columns": columns and column_keys(columns),
        },
    )
    place = None if out is None else place_of(out, chosen.experiment.name)
    n_blocks = chosen.experiment.fit.folds if held_out else None
    if table is not None:
        if place is None:
            raise InputError("table: needs out, the folder of its results")
        if any(each is not None for each in (experiment, ground_truth, chunk_frames)):
            raise InputError(
                "table: does not go with experiment, ground_truth and chunk_frames; name files in"
                " its columns recording.path and ground_truth.path"
            )
        inputs = table_inputs(chosen.experiment, table)
        if dry_run:
            return "\n".join(check_input(each) for each in inputs)
        return run_table(inputs, place, n_blocks=n_blocks, jobs=jobs, cluster=cluster)
    if dry_run:
        return check_input(chosen)
    if place is not None:
        check_writable(place)
        check_same_drive(place, chosen.experiment)
    result = run_input(chosen, n_blocks=n_blocks, chunk_frames=chunk_frames)
    if place is None:
        return result
    return replace(result, directory=result.save(place, figures=figures))


def check_same_drive(place: Path, experiment: Experiment) -> None:
    """Raise InputError if a directory has the result of another recording."""
    try:
        old = json.loads((place / "run.json").read_text())["config"]["recording"]
        name = old.get("path") or old.get("simulate")
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return  # A result of another version, or a damaged one, is replaced.
    if name != (experiment.recording.path or experiment.recording.simulate):
        raise InputError(f"out: {place} has the result of another recording, {name}; name another")


def check_input(given: Input) -> str:
    """Check an experiment without reading its recording; return a line about it."""
    experiment = given.experiment
    if experiment.recording.path != IN_MEMORY:
        check_sources(experiment)
    if experiment.n_lanes == FROM_MAP:
        # The number of lanes is known after reading only; any number shows whether plugins fit.
        experiment = load_experiment(experiment, {"road": None}, n_lanes=2)
    model = compile_model(experiment)
    if experiment.fit != FitSettings():
        # Optuna is loaded for this only.
        from egolane_pgm.studies.fits import search_space
        from egolane_pgm.studies.search import settings_of

        settings_of(experiment.fit, source=experiment.source)
        search_space([model], experiment.fit)
    return (
        f"{given.experiment.source}: ok ({model.n_lanes} lanes,"
        f" {model.compiled.n_states} joint states)"
    )


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
      recording), a Study (its fitted model on its recording), or lines (a file, a DataFrame or a
      LineLog).
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
    if not isinstance(given, Result) and hasattr(given, "in_sample"):
        if len(given.experiments) > 1:
            raise InputError(f"{given.name}: a study of several recordings can be a graph only")
        given = replace(given.in_sample, experiment=given.experiment)
    if isinstance(given, Result):
        if given.experiment.recording.path == IN_MEMORY:
            lines = LineLog.concat([*given.lines.values()])
            truth = given.truth if truth is None else truth
        given = given.experiment
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
        loaded = with_graph(loaded, graph)
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


def run_input(
    given: Input,
    *,
    n_blocks: int | None = None,
    chunk_frames: int | None = None,
) -> Result:
    """Run an experiment. n_blocks: hold out each of some blocks; chunk_frames: see `infer`."""
    experiment, lines, truth, tags = given
    if n_blocks is None:
        return run_experiment(experiment, lines, truth, chunk_frames=chunk_frames, tags=tags)
    # It can search: other runs do without Optuna.
    from egolane_pgm.studies.study import run_held_out

    with noting() as notes:
        drives = given.drives()
    return run_held_out(drives, n_blocks, experiment=experiment, notes=notes)


# --- tables of runs ------------------------------------------------------------------------------


def read_runs(table: str | os.PathLike[str] | pd.DataFrame) -> tuple[list[dict[str, Any]], Path]:
    """The rows of a table of runs, without empty cells, and the folder of its paths.

    - table: a DataFrame, or a CSV whose cells are YAML, except names, paths and tags.

    Raises InputError for an unknown column and for a table without rows.
    """
    if isinstance(table, pd.DataFrame):
        cells, folder, where = plain(table, "table"), Path.cwd(), "table"
    else:
        cells = plain(_read_csv(Path(table)), str(table))
        folder, where = Path(table).absolute().parent, str(table)
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
    experiment: ExperimentLike, table: str | os.PathLike[str] | pd.DataFrame
) -> list[Input]:
    """One run per row of a table of runs.

    A row with another `recording.path` keeps the reading options of the experiment (format, topic,
    columns) and drops the keys of the old drive: simulation, frames, ground truth, road. A row
    without `name` is named after its recording, or after the experiment and its row number.

    Raises InputError, naming the row, for a row that does not fit and for two of the same name.
    """
    base = load_experiment(experiment)
    rows, folder = read_runs(table)
    found: dict[str, Input] = {}
    for number, row in enumerate(rows, start=1):
        where = f"{base.source}: row {number}"
        tags = {key.removeprefix(TAG): str(v) for key, v in row.items() if key.startswith(TAG)}
        changes = absolute(nest({k: v for k, v in row.items() if not k.startswith(TAG)}), folder)
        content = base.keys
        name = f"{base.name}_{number}"
        if "path" in changes.get("recording", {}):
            content = {k: v for k, v in content.items() if k not in ("ground_truth", "road")}
            old = camera_beside(str(base.recording.path))
            kept = {k: v for k, v in content["recording"].items() if k not in DRIVE_KEYS}
            content["recording"] = {k: v for k, v in kept.items() if v != old}
            path = Path(changes["recording"]["path"])
            name = f"{path.parent.name}_{path.stem}"
            if isinstance(content.get("tuned_on"), str) and str(path) != base.recording.path:
                content["tuned_on"] = on_other_lines(content["tuned_on"])
        name = safe_name(str(row.get("name", name)))
        if name in found:
            raise InputError(f"{where}: another row has the name {name}; add a column `name`")
        content = with_camera({**merge(content, changes), "name": name})
        found[name] = Input(make_experiment(content, where), tags=tags)
    return list(found.values())


def run_table(
    inputs: Sequence[Input],
    out: str | os.PathLike[str],
    *,
    n_blocks: int | None = None,
    jobs: int = 1,
    cluster: str | None = None,
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
    done = list(bar(rows, total=len(inputs), unit="run"))
    summary = pd.DataFrame(done).set_index("name")
    try:
        with atomic(folder / SUMMARY) as temporary:
            summary.to_parquet(temporary)
    except InputError as error:
        # The reasons of rows that failed are still returned.
        warnings.warn(str(error), UserWarning, stacklevel=2)
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
