"""The verb `run`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, overload

import pandas as pd
from annotated_types import Ge

from egolane_pgm.drives import check_sources
from egolane_pgm.experiment import FROM_MAP, Experiment, FitSettings
from egolane_pgm.loading import IN_MEMORY, ExperimentLike, load_experiment
from egolane_pgm.model import compile_model
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.result import Result, check_writable, is_result
from egolane_pgm.runs import Input, open_input, run_input, run_table, table_inputs
from egolane_pgm.types import InputError
from egolane_pgm.verbs import options
from egolane_pgm.verbs.options import Option, StrPath, place_of

EXAMPLES = (
    "egolane run lines.csv --n-lanes 4",
    "egolane run experiments/quickstart.yaml --set parameters.sigma1=0.3",
    "egolane run drive/lines.csv --experiment experiments/zero_label.yaml --n-lanes 4 --out mine",
    "egolane run experiments/quickstart.yaml --table runs.csv --out results/runs",
    "egolane run drive/experiment.yaml --dry-run",
)


@overload
def run(given: Any, *, table: StrPath | pd.DataFrame, **options: Any) -> pd.DataFrame: ...


@overload
def run(given: Any, **options: Any) -> Result: ...


# The overloads leave the options to this one.
def run(  # type: ignore[misc]
    given: Annotated[ExperimentLike | options.Lines | Result, Option("EXPERIMENT|LINES")],
    *,
    experiment: Annotated[ExperimentLike | None, Option("X.yaml")] = None,
    overrides: options.Overrides = (),
    ground_truth: Annotated[options.Truth | None, Option("FILE|none")] = None,
    n_lanes: int | None = None,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    detector: options.Detector = None,
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

    EXPERIMENT is a YAML file, or a name that `egolane show` lists. LINES is a recording of lines,
    which is run with the model of an experiment.

    With a table the experiment is run once per row of overrides: a result directory for each, and
    summary.parquet. Rows that have a result already are skipped; a row that fails does not stop the
    others.

    - given: an experiment; lines: a file, a DataFrame (see `read_lines`) or a LineLog; or a Result,
      whose experiment is run again on its recording.
    - experiment: the model for LINES (evidence, graph, filter, parameters), by default zero_label.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0, recording.topic=/lanes.
    - ground_truth: annotated lanes, a file or a DataFrame with frame_id, lane and crossing; "none"
      to run without.
    - n_lanes: number of lanes of the road.
    - camera: camera of pictures, or of lines in pixels.
    - detector: line detector for a video or pictures.
    - columns: names and units of a table's columns or of fields, e.g.
      offset_m=lateral,unit=cm,left_positive=true (docs/howto/csv.md).
    - graph: another graph: a name or a file; in Python also a module or a pgmpy network.
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
    files only with `out`. Raises InputError if the arguments do not fit.

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
    result = replace(result, directory=result.save(place))
    if figures:
        from egolane_pgm.views.strips import draw_strips

        draw_strips(result, place / "figures" / "strips.png")
    return result


def check_same_drive(place: Path, experiment: Experiment) -> None:
    """Raise InputError if a directory has the result of another recording."""
    if not is_result(place):
        return
    try:
        old = dict(json.loads((place / "run.json").read_text())["config"]["recording"])
    except (OSError, ValueError, LookupError, TypeError):
        return  # A result of another version, or a damaged one, is replaced.
    new = experiment.model_dump(mode="json")["recording"]
    if any(old.get(key) != new.get(key) for key in ("path", "simulate")):
        name = old.get("path") or old.get("simulate")
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


def text(done: pd.DataFrame | str, style: str, wide: bool) -> str:
    """The output for a table of runs, or for a dry run."""
    from egolane_pgm.views.display import runs_text

    return done if isinstance(done, str) else runs_text(done, style, wide)


def summary(done: Result | pd.DataFrame, given: Mapping[str, Any]) -> str:
    """The paths of the results."""
    if isinstance(done, Result):
        picture = Path(str(done.directory)) / "figures" / "strips.png"
        return f"result: {done.directory}" + f"; picture: {picture}" * picture.is_file()
    good, there = int(done["error"].isna().sum()), int(done["was_there"].fillna(False).sum())
    return f"results: {good} of {len(done)} in {given['out']}, {there} were there"
