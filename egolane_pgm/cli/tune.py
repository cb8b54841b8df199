"""The command `egolane tune`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from egolane_pgm.cli.studies import (
    address_of,
    check_alone,
    is_named,
    join_studies,
    storage_options,
)

if TYPE_CHECKING:
    from egolane_pgm.tune.plan import Plan
    from egolane_pgm.tune.tuning import Progress


@click.command()
@click.argument("experiments", nargs=-1, type=click.Path(dir_okay=False))
@click.option("--runs", help="Runs of the paper, e.g. 1-10.")
@click.option("--trials", type=click.IntRange(1), help="Total of a study.  [default: 3000]")
@click.option(
    "--objective",
    "objectives",
    multiple=True,
    help="A score by name; several times for a Pareto front.  [default: accuracy]",
)
@click.option(
    "--sampler", help="evolution (default), tpe, cma-es, random; nsga2 for several objectives."
)
@click.option("--seed", type=click.IntRange(0), help="[default: 0]")
@click.option("--from-scratch", is_flag=True, help="Do not try the known values first.")
@click.option(
    "--parameter",
    "-p",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    help="Narrow, p1=[0.5,1], or fix, p1=0.9; several times.",
)
@click.option("--blocks", type=click.IntRange(2), help="Blocks held out in turn.  [default: 5]")
@click.option(
    "--whole-recordings", is_flag=True, help="Hold out each recording in turn, not blocks."
)
@click.option("--test-on", type=click.Path(dir_okay=False), metavar="YAML", help="Score there too.")
@click.option("--in-sample-only", is_flag=True, help="No nested studies: in-sample scores only.")
@click.option("--together", is_flag=True, help="One parameter set for all the experiments.")
@click.option("--out", default="results/tuning", show_default=True, help="A directory per study.")
@click.option("--no-figures", is_flag=True, help="Do not draw figures/ in each study's directory.")
@click.option(
    "--workers", type=click.IntRange(1), help="Processes that share the trials of one study."
)
@click.option(
    "--jobs",
    type=click.IntRange(1),
    help="Processes that share the studies.  [default: the processor's cores]",
)
@storage_options
@click.option(
    "--join",
    multiple=True,
    metavar="STUDY",
    help="Take part in a study of the storage; needs no EXPERIMENTS.",
)
@click.option(
    "--grace",
    type=click.FloatRange(min=1),
    help="Of a new study in a storage: seconds after which a silent worker is dead.  [default: 60]",
)
@click.option(
    "--format",
    "style",
    type=click.Choice(["markdown", "latex", "csv"]),
    default="markdown",
    show_default=True,
)
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override the YAML.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False), metavar="FILE")
def tune(
    experiments: tuple[str, ...],
    runs: str | None,
    trials: int | None,
    objectives: tuple[str, ...],
    sampler: str | None,
    seed: int | None,
    from_scratch: bool,
    parameters: tuple[str, ...],
    blocks: int | None,
    whole_recordings: bool,
    test_on: str | None,
    in_sample_only: bool,
    together: bool,
    out: str,
    no_figures: bool,
    workers: int | None,
    jobs: int | None,
    storage: str | None,
    password_file: str | None,
    join: tuple[str, ...],
    grace: float | None,
    style: str,
    overrides: tuple[str, ...],
    json_file: str | None,
) -> None:
    """Search parameters; report what they are worth on frames that they have not seen.

    A repeated command goes on where it stopped. EXPERIMENTS: experiments, or tuning files.

    With --storage the study is kept in PostgreSQL, and other machines may share it: with the same
    command, or with --join and its name.
    """
    from egolane_pgm.results import SCHEMA_VERSION, check_place, write_json
    from egolane_pgm.tune import plan as planning
    from egolane_pgm.tune.joining import tune_shared
    from egolane_pgm.tune.postgres import GRACE_S
    from egolane_pgm.tune.tuning import n_trials, prepare
    from egolane_pgm.tune.tuning import tune as run_studies
    from egolane_pgm.types import InputError

    address = address_of(storage, password_file) if join or is_named(storage) else None
    if join:
        check_alone(("join", "storage", "password_file", "workers"))
        assert address is not None
        with _bar(None) as progress:
            lines = join_studies(join, address, workers or _jobs(None, None), progress)
        click.echo("\n".join(lines))
        return
    if in_sample_only and (whole_recordings or blocks is not None):
        raise InputError("--in-sample-only: goes with neither --blocks nor --whole-recordings")
    if whole_recordings and blocks is not None:
        raise InputError("--whole-recordings: a recording is the block, leave --blocks away")
    if workers is not None and jobs is not None:
        raise InputError("--workers: shares one study, --jobs several; take one of the two")
    if address is not None and jobs is not None:
        raise InputError("--jobs: goes with no --storage (or EGOLANE_STORAGE); take --workers")
    if address is None and (grace is not None or password_file is not None):
        option = "--grace" if grace is not None else "--password-file"
        raise InputError(f"{option}: goes with --storage")
    options = {
        "trials": trials,
        "objective": objectives or None,
        "sampler": sampler,
        "seed": seed,
        "blocks": blocks,
        "from_scratch": from_scratch or None,
        "parameters": _parameters(parameters),
    }
    plans = [planning.with_options(p, options) for p in _plans(experiments, runs, overrides)]
    if together:
        plans = [planning.together(plans)]
    if json_file:
        check_place(Path(json_file))
    held_out = "none" if in_sample_only else "recordings" if whole_recordings else "blocks"
    test = None if test_on is None else planning.load_plan(test_on)
    _check_names(plans)
    studies = [prepare(p, Path(out) / p.name, held_out, test) for p in plans]
    for note in dict.fromkeys(note for study in studies for note in study.notes):
        click.echo(f"warning: {note}", err=True)
    with _bar(n_trials(studies)) as progress:
        if address is None:
            done = run_studies(
                studies, jobs=_jobs(jobs, workers), workers=workers, progress=progress
            )
        else:
            done = tune_shared(
                studies,
                address,
                workers=workers or _jobs(None, None),
                grace_s=grace or GRACE_S,
                progress=progress,
            )
        documents = list(done)
    _print(documents, style)
    folders = ", ".join(str(study.directory) for study in studies[:3])
    if style == "markdown":
        click.echo(f"\nstudies: {folders}{', ...' if len(studies) > 3 else ''}; best.yaml: run it")
    if not no_figures:
        _draw([study.directory for study in studies])
    if json_file:
        write_json(Path(json_file), {"schema_version": SCHEMA_VERSION, "studies": documents})


def _draw(directories: Sequence[Path]) -> None:
    from egolane_pgm.report.study_figures import draw_study

    for directory in directories:
        draw_study(directory)


def _jobs(jobs: int | None, workers: int | None) -> int:
    import os

    if workers is not None:
        return 1
    if jobs is not None:
        return jobs
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def _plans(experiments: Sequence[str], runs: str | None, overrides: Sequence[str]) -> list[Plan]:
    from egolane_pgm.paper import parse_runs
    from egolane_pgm.tune.plan import load_plan, paper_plans
    from egolane_pgm.types import InputError

    if bool(experiments) == bool(runs):
        raise InputError("tune: name experiments, or runs of the paper with --runs 1-10")
    if runs:
        if overrides:
            raise InputError("--set: goes with an experiment's YAML, not with --runs")
        return paper_plans(parse_runs(runs))
    return [load_plan(path, overrides) for path in experiments]


def _check_names(plans: Sequence[Plan]) -> None:
    from egolane_pgm.types import InputError

    names = [plan.name for plan in plans]
    for plan in plans:
        if names.count(plan.name) > 1:
            raise InputError(f"{plan.source}: another experiment has the name {plan.name} too")


def _parameters(given: Sequence[str]) -> dict[str, Any]:
    import yaml

    from egolane_pgm.types import InputError

    found = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise InputError(f"--parameter {text}: write it as p1=[0.5,1] or p1=0.9")
        try:
            found[name.strip()] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise InputError(f"--parameter {text}: the value is not YAML") from error
    return found


class _bar:
    """A progress bar on stderr; silent where that is no terminal."""

    def __init__(self, total: int | None) -> None:
        from tqdm import tqdm

        # tqdm's monitor is a thread, and processes are forked below.
        tqdm.monitor_interval = 0
        self.bar = tqdm(total=total, unit="trial", leave=False, disable=None)

    def __enter__(self) -> Progress:
        def progress(label: str, more: int, best: float) -> None:
            self.bar.set_description(label, refresh=False)
            self.bar.set_postfix(best=f"{best:.4f}", refresh=False)
            self.bar.update(more)

        return progress

    def __exit__(self, *_: object) -> None:
        self.bar.close()


def _print(documents: Sequence[Mapping[str, Any]], style: str) -> None:
    from egolane_pgm.report import study_tables as tables
    from egolane_pgm.report import tables as text

    draw = {"markdown": text.markdown, "latex": text.latex, "csv": text.as_csv}[style]
    for title, mine in tables.by_country(documents).items():
        if style == "markdown":
            click.echo(f"{title}\n")
        score = next(iter(mine[0]["best"]["values"]))
        shown = score if score in ("accuracy", "f1", "log_loss") else "accuracy"
        header, rows = tables.parameter_rows(mine, shown)
        click.echo(draw(header, rows) + ("\n" if style == "markdown" else ""))
    if style != "markdown":
        return
    if len(documents) == 1:
        header, rows = tables.score_rows(documents[0])
        click.echo(f"{text.markdown(header, rows)}\n")
    click.echo(tables.LEGEND)
