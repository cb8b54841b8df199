"""The command `egolane run`: one experiment, or many in several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from egolane_pgm.api.fleets import SUMMARY, run_fleet
from egolane_pgm.api.runs import choose, name_all, run_streamed
from egolane_pgm.api.runs import run as run_experiment
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.drive import named_files
from egolane_pgm.experiment import Experiment
from egolane_pgm.report.clips import clip_parts
from egolane_pgm.report.events import (
    event_lines,
    event_rows,
    event_runs_rows,
    lane_words,
    sure_words,
)
from egolane_pgm.report.fleet_table import fleet_table_rows
from egolane_pgm.report.tables import (
    TUNED_ON,
    Table,
    confusion_table,
    page,
    runs_table_rows,
    score_rows,
)
from egolane_pgm.results import SCHEMA_VERSION, Result, check_writable
from egolane_pgm.running import OneOfSeveral, plan_runs, run_all
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError

#: Makes the text of what is printed.
Show = Callable[[Sequence[str | Table]], str]

#: So many drives that failed are named.
_MANY = 20


@click.command()
@options.experiments(required=True)
@options.overrides()
@click.option(
    "--recording",
    "recordings",
    multiple=True,
    metavar="FILE",
    help="Run on this recording instead; several times: on each of them.",
)
@click.option("--ground-truth", metavar="FILE|none", help="Annotation of the recording, if any.")
@click.option("--n-lanes", type=int, help="Number of lanes of the road.")
@options.of_recording
@options.fleet
@click.option(
    "--stream",
    is_flag=True,
    help="Make and write beliefs part after part, for long drives.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Result directory; of several runs, their folder.",
)
@click.option("--no-figures", is_flag=True, help="Draw nothing; otherwise the belief over time.")
@options.jobs
@options.tables
@options.json_file
def run(
    experiments: tuple[str, ...],
    overrides: tuple[str, ...],
    recordings: tuple[str, ...],
    ground_truth: str | None,
    n_lanes: int | None,
    frame_id: str | None,
    camera: str | None,
    detector: str | None,
    fleet: str | None,
    stream: bool,
    out: str | None,
    no_figures: bool,
    jobs: Jobs,
    style: str,
    wide: bool,
    json_file: Path | None,
) -> None:
    """Run experiments: filter the recording, score it, tell its lane changes, write a result
    directory.

    Without ground truth it says the lane over time. A recording of many clips (TuSimple's test
    labels, folders of CULane or OpenLane) is run clip by clip, with one table.

    Several EXPERIMENTS, or one on several recordings, share --jobs processes; each has its own
    result directory, and one that fails does not stop the others.

    With --fleet one experiment runs on every drive of a table: a result directory for each, without
    figures, and summary.parquet. Drives whose result is there already are not run again.

    With --stream beliefs are made and written part after part, so that a long drive does not fill
    the memory: the same numbers, without figures. What needs the whole drive is refused.
    """
    if "" in (*recordings, ground_truth, camera, out):
        raise InputError("run: a file or folder that is named is empty (--recording, --out, ...)")
    changes = (ground_truth, n_lanes, frame_id, camera, detector)
    show = partial(page, style=style, wide=wide)
    if stream and (fleet is not None or len(experiments) > 1 or len(recordings) > 1):
        raise InputError("--stream: goes with one experiment and one recording")
    if fleet is not None:
        if len(experiments) > 1 or recordings or any(change is not None for change in changes):
            raise InputError("--fleet: goes with one experiment; the table names the recordings")
        _run_fleet(experiments[0], overrides, fleet, Path(out or "results"), show, jobs, json_file)
        return
    if len(experiments) == 1 and len(recordings) < 2:
        recording = recordings[0] if recordings else None
        chosen = choose(experiments[0], overrides, recording, *changes)
        directory = Path(out or Path("results") / chosen.name)
        _run_one(chosen, directory, show, not no_figures, json_file, stream=stream)
        click.echo(f"\nresult: {directory}", err=style != "markdown")
        return
    to_load = name_all(experiments, overrides, recordings, *changes)
    _run_many(to_load, Path(out or "results"), not no_figures, show, jobs, json_file)


def _run_one(
    chosen: Experiment,
    directory: Path,
    show: Show,
    figures: bool,
    json_file: Path | None,
    *,
    stream: bool,
) -> None:
    check_writable(directory)
    if json_file:
        check_not_read(json_file, named_files(chosen))
    if stream:
        done = run_streamed(chosen, directory)
    else:
        done = run_experiment(chosen)
        done.save(directory, figures=figures)
    # The file is written before anything is printed, because a reader may close the pipe.
    if json_file:
        write_json(json_file, done.scores)
    for note in done.notes:
        options.warn(note)
    click.echo(show(_parts(done)))


def _run_many(
    to_load: Sequence[tuple[str, Callable[[], Experiment]]],
    folder: Path,
    figures: bool,
    show: Show,
    jobs: Jobs,
    json_file: Path | None,
) -> None:
    plan = plan_runs(to_load, folder)
    if json_file:
        chosen = [each.experiment for each in plan if each.experiment is not None]
        check_not_read(json_file, [file for each in chosen for file in named_files(each)])
    before = {each.directory: _inode(each.directory) for each in plan}
    outcomes: list[OneOfSeveral] = []
    try:
        done = run_all(plan, jobs=jobs, figures=figures)
        outcomes.extend(bar(done, total=len(plan), unit="run"))
    except KeyboardInterrupt:
        # A result that was rewritten has a new inode.
        written = sum(_inode(place) not in (None, was) for place, was in before.items())
        raise KeyboardInterrupt(
            f"{written} of {len(plan)} are in {folder}; the same command begins anew"
        ) from None
    failed = [o for o in outcomes if o.error is not None]
    if json_file:
        document = {
            "schema_version": SCHEMA_VERSION,
            "runs": [{"result": str(o.directory), **o.scores} for o in outcomes if o.scores],
            "failed": [{"experiment": o.title, "error": o.error} for o in failed],
        }
        write_json(json_file, document)
    for outcome in outcomes:
        for note in (outcome.scores or {}).get("warnings", ()):
            options.warn(note, outcome.title)
    summaries = [o.scores for o in outcomes if o.scores is not None]
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
    parts.append(f"results: {len(outcomes) - len(failed)} of {len(outcomes)} in {folder}")
    click.echo(show(parts))
    for outcome in failed:
        for line in (outcome.error or "").splitlines():
            options.failed(outcome.title, line)
    if failed:
        raise SystemExit(1)


def _run_fleet(
    experiment: str,
    overrides: tuple[str, ...],
    fleet: str,
    folder: Path,
    show: Show,
    jobs: Jobs,
    json_file: Path | None,
) -> None:
    if json_file:
        check_not_read(json_file, [Path(experiment), Path(fleet)])
    done = run_fleet(experiment, fleet, folder, overrides=overrides, jobs=jobs)
    if json_file:
        write_json(json_file, {"schema_version": SCHEMA_VERSION, "drives": done.rows})
    click.echo(show([Table(*fleet_table_rows(done.rows))]))
    there = f", {done.were_there} of them were there" if done.were_there else ""
    click.echo(f"\n{len(done)} drives in {folder}{there}; a row for each in {folder / SUMMARY}")
    for name, error in done.failed[:_MANY]:
        options.failed(name, error)
    if len(done.failed) > _MANY:
        click.echo(f"failed: {len(done.failed) - _MANY} more, see the column `error`", err=True)
    if done.failed:
        raise SystemExit(1)


def _inode(directory: Path) -> int | None:
    return directory.stat().st_ino if directory.is_dir() else None


def _parts(done: Result) -> list[str | Table]:
    experiment, said = done.experiment, done.scores
    log_evidence = said["mean_log_evidence"]
    first = [
        f"{said['name']}: {len(done)} frames, {experiment.n_lanes} lanes, graph {experiment.graph},"
        f" mean log evidence {math.nan if log_evidence is None else log_evidence:.4f}",
        *said["why_not_causal"],
    ]
    scores: dict[str, Any] = {
        who: done.scores[who] for who in ("detector", "model") if who in done.scores
    }
    if scores:
        first.append(f"{said['frames_scored']} frames scored (crossing ones are not);")
        first.append(f"parameters: {TUNED_ON[said['tuned_on']]}")
    else:
        first.append("no ground truth: beliefs only, no scores (--ground-truth names a file)")
    parts: list[str | Table] = ["\n".join(first)]
    if scores:
        parts.append(Table(*score_rows(scores)))
    else:
        parts += _lane_parts(done)
    parts += [confusion_table(mine["confusion"], name) for name, mine in scores.items()]
    return parts + (_event_parts(done) if done.clip is None else [])


def _lane_parts(done: Result) -> list[str | Table]:
    if done.clip is None:
        last = done.beliefs.lane[-1]
        best = int(last.argmax())
        at_the_end = f"at the end lane {best + 1} is the most probable ({last[best]:.2f})"
        return [f"{lane_words(done.scores)}; {at_the_end}\n{sure_words(done.scores)}"]
    where = "a row for each clip: clips.csv; its frames: beliefs.parquet"
    return [*clip_parts(done), f"{sure_words(done.scores)}\n{where}"]


def _event_parts(done: Result) -> list[str | Table]:
    events, scores = done.events, done.scores["events"]
    header, rows = event_rows(events)
    parts: list[str | Table] = [Table(header, rows) if rows else "no lane change was believed"]
    if len(events) > len(rows):
        parts.append(f"and {len(events) - len(rows)} more in events.csv")
    if "within" in scores:
        parts.append("\n".join(event_lines(scores)))
    return parts
