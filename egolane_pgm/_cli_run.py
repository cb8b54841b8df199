"""The command `egolane run`: one experiment, or many in several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from egolane_pgm.experiment import Experiment
    from egolane_pgm.run import Run


def _recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in (
        click.option(
            "--recording",
            "recordings",
            multiple=True,
            metavar="FILE",
            help="Run on this recording instead; several times: on each of them.",
        ),
        click.option(
            "--ground-truth", metavar="FILE|none", help="Annotation of the recording, if any."
        ),
        click.option("--n-lanes", type=int, help="Number of lanes of the road."),
        click.option("--camera", metavar="FILE", help="Its camera, for a video or pictures."),
        click.option("--detector", metavar="NAME|FILE.py", help="What looks at the video."),
        click.option(
            "--frame-id",
            type=click.Choice(["way_id", "seq"]),
            help="Which number of a bag's messages is the frame id.",
        ),
    ):
        command = option(command)
    return command


@click.command()
@click.argument("experiments", nargs=-1, required=True, type=click.Path(dir_okay=False))
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a key of the YAML, e.g. parameters.bonus_value=0.",
)
@_recording_options
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Result directory; of several runs, their folder.",
)
@click.option("--no-figures", is_flag=True, help="Draw nothing.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option(
    "--numpy", "use_numpy", is_flag=True, help="Use the plain NumPy twins of the kernels."
)
@click.option(
    "--json",
    "json_file",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write the unrounded numbers as JSON.",
)
def run(
    experiments: tuple[str, ...],
    overrides: tuple[str, ...],
    recordings: tuple[str, ...],
    ground_truth: str | None,
    n_lanes: int | None,
    frame_id: str | None,
    camera: str | None,
    detector: str | None,
    out: str | None,
    no_figures: bool,
    jobs: int,
    use_numpy: bool,
    json_file: str | None,
) -> None:
    """Run experiments: filter the recording, score it, write a result directory.

    Several EXPERIMENTS, or one on several recordings, share --jobs processes; each has its own
    result directory, and one that fails does not stop the others.
    """
    from egolane_pgm.results import check_place
    from egolane_pgm.types import InputError

    if len(recordings) > 1 and (len(experiments) > 1 or ground_truth not in (None, "none")):
        raise InputError(
            "run: several --recording go with one experiment and no --ground-truth; write one"
            " experiment per recording that has its own"
        )
    if json_file:
        check_place(Path(json_file))
    draw = None if no_figures else _draw_all
    changes = (ground_truth, n_lanes, frame_id, camera, detector)
    if len(experiments) == 1 and len(recordings) < 2:
        recording = recordings[0] if recordings else None
        chosen = _load(experiments[0], overrides, recording, *changes)
        _run_one(chosen, Path(out) if out else None, draw, not use_numpy, json_file)
        return
    jobs_to_do = [
        (path, overrides, recording, *changes)
        for path in experiments
        for recording in recordings or (None,)
    ]
    _run_many(jobs_to_do, Path(out or "results"), draw, not use_numpy, jobs, json_file)


def _load(
    path: str,
    overrides: Sequence[str],
    recording: str | None,
    ground_truth: str | None,
    n_lanes: int | None,
    frame_id: str | None,
    camera: str | None,
    detector: str | None,
) -> Experiment:
    from egolane_pgm.experiment import load_experiment, with_recording

    found = load_experiment(path, overrides)
    changes = (recording, ground_truth, n_lanes, frame_id, camera, detector)
    return found if changes == (None,) * 6 else with_recording(found, *changes)


def _run_one(
    chosen: Experiment,
    out: Path | None,
    draw: Callable[[Path], None] | None,
    kernel: bool,
    json_file: str | None,
) -> None:
    from egolane_pgm.results import SCHEMA_VERSION, check_writable, write_json
    from egolane_pgm.run import run_experiment, save_run, summary

    directory = out or Path("results") / chosen.name
    check_writable(directory)
    done = run_experiment(chosen, kernel=kernel)
    save_run(done, directory, draw)
    _print_run(done)
    click.echo(f"\nresult: {directory}")
    if json_file:
        write_json(Path(json_file), {"schema_version": SCHEMA_VERSION, **summary(done)})


def _run_many(
    to_load: Sequence[tuple[Any, ...]],
    folder: Path,
    draw: Callable[[Path], None] | None,
    kernel: bool,
    jobs: int,
    json_file: str | None,
) -> None:
    from tqdm import tqdm

    from egolane_pgm.report.tables import runs_table
    from egolane_pgm.results import SCHEMA_VERSION, write_json
    from egolane_pgm.run_many import plan_runs, run_all

    # tqdm's monitor is a thread, and processes are forked.
    tqdm.monitor_interval = 0
    plan = plan_runs([(task[0], partial(_load, *task)) for task in to_load], folder)
    done = run_all(plan, jobs=jobs, draw=draw, kernel=kernel)
    outcomes = list(tqdm(done, total=len(plan), unit="run", leave=False, disable=None))
    for outcome in outcomes:
        for note in (outcome.summary or {}).get("warnings", ()):
            click.echo(f"warning: {outcome.title}: {note}", err=True)
    click.echo(runs_table([o.summary for o in outcomes if o.summary is not None]))
    failed = [o for o in outcomes if o.error is not None]
    written = len(outcomes) - len(failed)
    click.echo(f"\nresults: {written} of {len(outcomes)} in {folder}")
    for outcome in failed:
        click.echo(f"failed: {outcome.title}: {outcome.error}", err=True)
    if json_file:
        document = {
            "schema_version": SCHEMA_VERSION,
            "runs": [{"result": str(o.directory), **o.summary} for o in outcomes if o.summary],
            "failed": [{"experiment": o.title, "error": o.error} for o in failed],
        }
        write_json(Path(json_file), document)
    if failed:
        raise SystemExit(1)


def _draw_all(directory: Path) -> None:
    from egolane_pgm.report.sheet import draw_standard

    draw_standard(directory)


def _print_run(done: Run) -> None:
    from egolane_pgm.report.tables import TUNED_ON, confusion_table, scores_table

    for note in done.notes:
        click.echo(f"warning: {note}", err=True)
    experiment = done.experiment
    click.echo(
        f"{experiment.name}: {len(done.beliefs)} frames, {experiment.n_lanes} lanes,"
        f" graph {experiment.graph}, mean log evidence {done.beliefs.mean_log_evidence:.4f}"
    )
    if not experiment.is_causal:
        later = "all later" if experiment.lag is None else f"the next {experiment.lag}"
        click.echo(f"{experiment.filter}: not causal, a frame's belief uses {later} frames too")
    if not done.scores:
        click.echo("no ground truth: beliefs only, no scores (--ground-truth names a file)")
        return
    click.echo(f"{done.scores['model']['frames_scored']} frames scored (crossing ones are not);")
    click.echo(f"parameters: {TUNED_ON[experiment.tuned_on]}\n")
    click.echo(scores_table(done.scores))
    for name, scores in done.scores.items():
        click.echo("\n" + confusion_table(scores["confusion"], name))
