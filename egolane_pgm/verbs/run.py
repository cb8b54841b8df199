"""The verb `run`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, overload

from egolane_pgm.drive import check_sources, most_lanes, source_of, with_recording
from egolane_pgm.drive_table import DriveTable
from egolane_pgm.experiment import Experiment, Given, Overrides, experiment_path, load_experiment
from egolane_pgm.fleet import numbers_of, plan_fleet, read_fleet, summary_rows, write_summary
from egolane_pgm.model import prepare_model
from egolane_pgm.recordings.source import IN_MEMORY, Read
from egolane_pgm.results import SCHEMA_VERSION, Result, check_writable
from egolane_pgm.running import (
    OneOfSeveral,
    Way,
    name_runs,
    plan_runs,
    run_all,
    run_experiment,
    run_in_parts,
)
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, LineLog, titled
from egolane_pgm.verbs.given import (
    Blocks,
    ColumnNames,
    Detector,
    Fleet,
    Hidden,
    Jobs,
    Lines,
    Option,
    Progress,
    StrPath,
    Truth,
    path_of,
    several_of,
)
from egolane_pgm.views.events import event_runs_rows, lane_words, sure_words
from egolane_pgm.views.fleet_table import fleet_table_rows
from egolane_pgm.views.tables import Table, runs_table_rows

EXAMPLES = (
    "egolane run lines.csv --n-lanes 4",
    "egolane run experiments/quickstart.yaml --set parameters.sigma1=0.3",
    "egolane run experiments/zero_label.yaml --recording drive/lines.csv --n-lanes 4 --out mine",
    "egolane run experiments/zero_label.yaml --recording drive/lines.csv --n-lanes 4 --stream",
    "egolane run drive/experiment.yaml --dry-run",
)

#: The experiment that runs on lines where none is named: it needs no label.
ZERO_LABEL = "zero_label"

#: The file in which a fleet's folder has a row for each drive.
SUMMARY = "summary.parquet"


@overload
def run(experiment: list[Any] | tuple[Any, ...], **options: Any) -> DriveTable: ...


@overload
def run(experiment: Given | Lines, *, fleet: StrPath, **options: Any) -> DriveTable: ...


@overload
def run(experiment: Given | Lines = ..., **options: Any) -> Result: ...


# The overloads leave the options to this one, where they stand once.
def run(  # type: ignore[misc]
    experiment: Annotated[
        Given | Lines | Sequence[Given | Lines], Option("EXPERIMENT|LINES...", many=True)
    ] = (),
    *,
    overrides: Overrides = (),
    recording: Annotated[Lines | Sequence[Lines] | None, Option("FILE", many=True)] = None,
    ground_truth: Annotated[Truth | None, Option("FILE|none")] = None,
    n_lanes: int | None = None,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    detector: Detector = None,
    topic: str | None = None,
    columns: ColumnNames = None,
    graph: Annotated[Any, Hidden] = None,
    fleet: Fleet = None,
    stream: bool = False,
    held_out: bool = False,
    blocks: Blocks = 5,
    dry_run: bool = False,
    out: Annotated[StrPath | None, Option("DIR", default="results/*", said="results/NAME")] = None,
    figures: bool = True,
    jobs: Jobs = 1,
    progress: Progress = None,
) -> Result | DriveTable | str:
    """Filter a recording, score it where there is ground truth, and list its lane changes.

    EXPERIMENT is a YAML file, or a name that `egolane show` lists. LINES is a recording of lines,
    run by the experiment zero_label, which needs no label. A recording of many clips (TuSimple's
    test labels) is run clip by clip, with one table.

    Several experiments, or one on several recordings, share the jobs; each has its own result
    directory, and one that fails does not stop the others. With a fleet one experiment runs on
    every drive of a table: a result directory for each, without figures, and summary.parquet;
    drives whose result is there already are not run again.

    - experiment: an experiment, or lines; or a list of several. Lines are a file, a DataFrame (see
      `read_lines`) or a LineLog.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    - recording: run on these lines instead; several: on each of them.
    - ground_truth: annotation of the recording, a file or a DataFrame with frame_id, lane and
      crossing; "none" for none.
    - n_lanes: number of lanes of the road.
    - camera: its camera: for pictures, lines in pixels.
    - detector: what looks at the video.
    - topic: topic of a bag, of its lines or pictures.
    - columns: what a table or messages call our columns, and how they write them, e.g.
      offset_m=lateral,unit=cm,left_positive=true (docs/howto/csv.md).
    - graph: a graph instead of the experiment's: its name or file, a module, or a
      DynamicBayesianNetwork.
    - fleet: a table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...
    - stream: make and write beliefs part after part, for long drives: the same numbers, without
      figures. What needs the whole drive is refused.
    - held_out: believe each block of the annotated frames with parameters that were found without
      it, as the experiment's `fit` says (none: its own, learn, tune).
    - blocks: with held_out: how many blocks there are.
    - dry_run: check keys, plugins, parameters and the names of files, and compute nothing. A .py
      that a YAML names is executed.
    - out: result directory; of several runs, their folder. A `*` in it is the run's name.
    - figures: draw the belief over time.
    - jobs: processes that share several runs.
    - progress: whether a bar shows how far several runs are; None for in a terminal.

    Returns a `Result`, or a `DriveTable` of several; of a dry run a line for each. Without `out`
    nothing is written. Raises InputError, one line, for whatever does not fit.

    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> frame = run.to_pandas()
    >>> int(frame["Lane=2"].idxmax()) in frame.index
    True
    >>> figure = run.plot()
    >>> lines = ego.simulate("a4", frames=300).log.to_pandas()
    >>> ego.run(lines, n_lanes=4)
    Result('in_memory': 300 frames, no ground truth; not tuned, causal)
    """
    given, recordings = several_of(experiment), several_of(recording)
    changes = (ground_truth, n_lanes, camera, detector, topic, columns, graph)
    folder = None if out is None else Path(path_of(out, "out"))
    if not given and not recordings:
        raise InputError("run: name an experiment, or a recording of lines")
    is_one = not isinstance(experiment, (list, tuple)) and not isinstance(recording, (list, tuple))
    if dry_run:
        if fleet is not None:
            raise InputError("dry_run: goes without fleet")
        return _checked(name_all(given or [ZERO_LABEL], overrides, recordings, *changes))
    if stream and (fleet is not None or not is_one or folder is None or held_out):
        raise InputError("stream: goes with one experiment, one recording and out")
    way: Way = run_experiment
    if held_out:
        # It can search: other runs do without Optuna.
        from egolane_pgm.held_out import run_held_out

        way = partial(run_held_out, n_blocks=blocks)
    if fleet is not None:
        if not is_one or recordings or any(change is not None for change in changes):
            raise InputError("fleet: goes with one experiment; the table names the recordings")
        return _run_fleet(given[0], overrides, fleet, _folder_of(folder), way, jobs, progress)
    if is_one:
        drive = recordings[0] if recordings else None
        first = given[0] if given else ZERO_LABEL
        chosen = choose(first, overrides, drive, *changes)
        read = read_of(chosen, first if drive is None else drive, ground_truth)
        place = None if folder is None else folder.with_name(folder.name.replace("*", chosen.name))
        if not stream:
            return _run_one(chosen, place, figures, read, way)
        if read is not None:
            raise InputError("stream: goes with a recording in a file")
        assert place is not None
        with bar(None, progress, unit="frame", unit_scale=True) as frames:
            return run_in_parts(chosen, place, frames.update)
    titled = name_all(given or [ZERO_LABEL], overrides, recordings, *changes)
    folder = None if folder is None else _folder_of(folder)
    plan = plan_runs(titled, folder)
    drive = recordings[0] if recordings else given[0]
    plan = [
        each
        if each.experiment is None
        else replace(each, read=read_of(each.experiment, drive, ground_truth))
        for each in plan
    ]
    return _run_several(plan, folder, figures, way, jobs, progress)


def says(done: Result | DriveTable | str, given: Mapping[str, Any]) -> str:
    """Where the results are; of a dry run what each experiment has."""
    if isinstance(done, str):
        return done
    if isinstance(done, Result):
        return f"result: {done.directory}"
    return f"results: {len(done) - len(done.failed)} of {len(done)} in {done.folder}"


def _checked(titled: Sequence[tuple[str, Callable[[], Experiment]]]) -> str:
    """Check experiments without computing anything; a line for each."""
    # Optuna is loaded for this only.
    from egolane_pgm.tuning.plan import check_tuning

    lines = []
    for title, load in titled:
        experiment = load()
        model = prepare_model(experiment, most_lanes(experiment))
        check_tuning(experiment, model)
        if experiment.recording.path != IN_MEMORY:
            check_sources(experiment)
        lines.append(f"{title}: ok ({model.n_lanes} lanes, {model.compiled.n_states} joint states)")
    return "\n".join(lines)


def _run_one(
    chosen: Experiment, place: Path | None, figures: bool, read: Read | None, way: Way
) -> Result:
    if place is None:
        return way(chosen, read=read)
    check_writable(place)
    done = way(chosen, read=read)
    done.save(place, figures=figures)
    return replace(done, directory=place)


def _folder_of(out: Path | None) -> Path:
    if out is None:
        raise InputError("fleet: needs out, the folder of its results")
    return out.parent if out.name == "*" else out


def _run_several(
    plan: Sequence[OneOfSeveral],
    folder: Path | None,
    figures: bool,
    way: Way,
    jobs: Jobs,
    progress: bool | None,
) -> DriveTable:
    done: list[OneOfSeveral] = []
    try:
        found = run_all(plan, way, jobs=jobs, figures=figures, keep=folder is None)
        done.extend(bar(found, progress, total=len(plan), unit="run"))
    except KeyboardInterrupt:
        kept = f"{len(done)} of {len(plan)} are in {folder}; " if folder else ""
        raise KeyboardInterrupt(f"{kept}the same command begins anew") from None
    if folder is None:
        if all(each.error is not None for each in done):
            raise InputError(f"{done[0].title}: {done[0].error}")
        for each in done:
            if each.error is not None:
                warnings.warn(f"{each.title}: {each.error}", UserWarning, stacklevel=3)
    return table_of_runs(done, folder)


def table_of_runs(done: Sequence[OneOfSeveral], folder: Path | None) -> DriveTable:
    """The table of several runs.

    - folder: where their results are; None where they are kept in memory.
    """
    summaries = [each.scores for each in done if each.scores is not None]
    parts: list[str | Table] = [
        Table(*runs_table_rows(summaries)),
        Table(*event_runs_rows(summaries), leaves_out=True),
    ]
    for found in summaries:
        if "model" not in found:
            lanes = (
                f"{found['clips']} clips, a row for each in clips.csv"
                if "clips" in found
                else lane_words(found)
            )
            parts.append(f"{found['name']}: {lanes}; {sure_words(found)}")
    names = [each.title for each in done]
    return DriveTable(
        ", ".join(map(repr, names[:5])) + ", ..." * (len(names) > 5),
        [
            {"name": each.title, "error": each.error, **numbers_of(each.scores or {})}
            for each in done
        ],
        parts,
        {
            "schema_version": SCHEMA_VERSION,
            "runs": [{"result": str(o.directory), **o.scores} for o in done if o.scores],
            "failed": [{"experiment": o.title, "error": o.error} for o in done if o.error],
        },
        {each.title: each.result for each in done if each.result is not None},
        folder,
        tuple(
            titled(each.title, note)
            for each in done
            for note in (each.scores or {}).get("warnings", ())
        ),
    )


def _run_fleet(
    experiment: Any,
    overrides: Overrides,
    fleet: StrPath,
    folder: Path,
    way: Way,
    jobs: Jobs,
    progress: bool | None,
) -> DriveTable:
    drives = read_fleet(path_of(fleet, "fleet"))
    plan = plan_fleet(load_experiment(experiment, overrides), drives, folder, overrides)
    done: list[OneOfSeveral] = []
    try:
        found = run_all(plan, way, jobs=jobs, resume=True)
        done.extend(bar(found, progress, total=len(plan), unit="drive"))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{len(done)} of {len(plan)} drives are in {folder}; the same command goes on"
        ) from None
    rows = summary_rows(drives, done)
    write_summary(folder / SUMMARY, rows)
    were_there = sum(each.was_there for each in done)
    there = f", {were_there} of them were there" if were_there else ""
    return DriveTable(
        f"{len(rows)} drives in {folder}, {sum(row['error'] is not None for row in rows)} failed",
        rows,
        [
            Table(*fleet_table_rows(rows)),
            f"{len(rows)} drives in {folder}{there}; a row for each in {folder / SUMMARY}",
        ],
        {"schema_version": SCHEMA_VERSION, "drives": rows},
        folder=folder,
    )


# --- the experiment that is meant --------------------------------------------------------------


def choose(
    given: Any,
    overrides: Overrides = (),
    recording: Any = None,
    ground_truth: Any = None,
    n_lanes: int | None = None,
    camera: Any = None,
    detector: Any = None,
    topic: str | None = None,
    columns: Any = None,
    graph: Any = None,
    *,
    name: str | None = None,
) -> Experiment:
    """The experiment that the arguments of `run` mean.

    - given: an experiment, or lines, which zero_label runs.
    - name: the name of the run, in which `*` stands for that of the experiment.
    """
    if is_lines(given):
        if recording is not None:
            raise InputError("recording: the lines that come first are a recording, too; name one")
        given, recording = ZERO_LABEL, given
    found = load_experiment(given, overrides)
    files: dict[str, str | None] = {
        "recording": _file_of(recording, "recording"),
        # What is in memory takes the place of a file's when the run reads.
        "ground_truth": None if _is_in_memory(ground_truth) else ground_truth,
        "camera": None if camera is None else path_of(camera, "camera"),
        "detector": None if detector is None else path_of(detector, "detector"),
    }
    chosen = found
    if n_lanes is not None or any(files.values()):
        chosen = with_recording(found, **files, n_lanes=n_lanes, overrides=overrides)
    said: dict[str, Any] = {"recording.topic": topic}
    if columns is not None:
        from egolane_pgm.recordings.columns import column_keys

        said["recording"] = {"columns": column_keys(columns)}
    if any(said.values()):
        chosen = load_experiment(chosen, {key: value for key, value in said.items() if value})
    if graph is not None:
        from egolane_pgm.comparing.graphs import with_graph
        from egolane_pgm.learning.graph_file import graph_named

        chosen = with_graph(chosen, graph_named(graph, chosen))
    if name is None:
        return chosen
    return chosen.model_copy(update={"name": name.replace("*", found.name)})


def read_of(experiment: Experiment, recording: Any, ground_truth: Any) -> Read | None:
    """What is in memory instead of in files; None where nothing is.

    - experiment: that is run; it says whether its lines are in memory.
    - recording: those lines then.
    """
    # `egolane run --help` does without pyarrow.
    from egolane_pgm.recordings.memory import in_memory, truth_of

    truth = ground_truth if _is_in_memory(ground_truth) else None
    if experiment.recording.path == IN_MEMORY:
        return in_memory(experiment, recording, truth)
    if truth is None:
        return None
    return replace(source_of(experiment).read(), truth=truth_of(truth))


def _is_in_memory(given: Any) -> bool:
    return given is not None and not isinstance(given, (str, os.PathLike))


def _file_of(recording: Any, what: str) -> str | None:
    if recording is None:
        return None
    return IN_MEMORY if _is_in_memory(recording) else path_of(recording, what)


def is_lines(given: Any) -> bool:
    """Whether what is given is a recording, and no experiment."""
    if isinstance(given, (Experiment, Mapping)):
        return False
    if _is_in_memory(given):
        return isinstance(given, LineLog) or hasattr(given, "columns")
    return experiment_path(given).suffix.lower() not in (".yaml", ".yml")


def name_all(
    experiments: Sequence[Any], overrides: Overrides, recordings: Sequence[Any], *changes: Any
) -> list[tuple[str, Callable[[], Experiment]]]:
    """The title of each of several runs, and a function that loads its experiment.

    - changes: arguments of `choose` from `ground_truth` to `detector`.

    Raises InputError for several recordings and several experiments, or one ground truth for them,
    and for a recording that is named twice.
    """
    if len(recordings) > 1 and (len(experiments) > 1 or changes[0] not in (None, "none")):
        raise InputError(
            "recording: several go with one experiment and no ground_truth; write one experiment"
            " per recording that has its own"
        )
    if len(recordings) > 1 and any(map(_is_in_memory, recordings)):
        raise InputError("recording: several are files; run what is in memory one by one")
    recordings = [IN_MEMORY if _is_in_memory(each) else each for each in recordings]
    titles = [
        given.source
        if isinstance(given, Experiment)
        else str(given.get("name", "experiment") if isinstance(given, Mapping) else given)
        for given in experiments
    ]
    return [
        (
            title,
            partial(
                choose,
                experiments[k if len(experiments) > 1 else 0],
                overrides,
                recording,
                *changes,
                name=name,
            ),
        )
        for k, (title, _, recording, name) in enumerate(name_runs(titles, recordings))
    ]
