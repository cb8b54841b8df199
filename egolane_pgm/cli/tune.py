"""The command `egolane tune`."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from egolane_pgm.api.studies import Search, prepare_searches, search_all
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.report import study_tables
from egolane_pgm.report.fleet_table import fleet_table_rows
from egolane_pgm.report.study_figures import draw_study
from egolane_pgm.report.study_trials import read_trials
from egolane_pgm.report.tables import Table, line_width, page
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.tuning.space import described

#: So many notes are printed: each drive of a fleet may have some.
_MANY = 20


@click.command()
@options.experiments(required=False)
@click.option("--runs", help="Runs of the paper, e.g. 1-10.")
@click.option("--trials", type=click.IntRange(1), help="Total of a study.  [default: 3000]")
@click.option(
    "--objective",
    "objectives",
    multiple=True,
    help="A score by name; several times for a Pareto front.  [default: accuracy]",
)
@click.option(
    "--sampler",
    help="evolution (default), tpe, cma-es, random; nsga2 for several objectives.",
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
@click.option(
    "--blocks",
    type=click.IntRange(2),
    help="Blocks held out in turn; of a fleet parts of its drives.  [default: 5]",
)
@click.option(
    "--whole-recordings", is_flag=True, help="Hold out each recording in turn, not blocks."
)
@click.option("--test-on", type=click.Path(dir_okay=False), metavar="YAML", help="Score there too.")
@click.option("--in-sample-only", is_flag=True, help="No nested studies: in-sample scores only.")
@click.option("--together", is_flag=True, help="One parameter set for all the experiments.")
@options.fleet
@options.by_tag
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
@options.cluster
@click.option(
    "--storage",
    envvar="EGOLANE_STORAGE",
    metavar="URL",
    help="A database that machines share, as Optuna names it; also EGOLANE_STORAGE."
    "  [default: study.journal in the study's directory]",
)
@options.tables
@options.overrides()
@options.json_file
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
    fleet: str | None,
    by_tag: str | None,
    out: str,
    no_figures: bool,
    workers: int | None,
    jobs: int | None,
    cluster: str | None,
    storage: str | None,
    style: str,
    wide: bool,
    overrides: tuple[str, ...],
    json_file: Path | None,
) -> None:
    """Search parameters; report what they are worth on frames that they have not seen.

    A repeated command goes on where it stopped. EXPERIMENTS: experiments, or tuning files.

    Every study is Optuna's, kept in study.journal of its directory or in --storage. Other machines,
    or terminals, join in it by giving the same command.

    With --fleet one parameter set is searched for all drives of a table.
    """
    searches = prepare_searches(
        experiments,
        folder=Path(out),
        runs=runs,
        trials=trials,
        objective=objectives,
        sampler=sampler,
        seed=seed,
        from_scratch=from_scratch,
        parameter=options.given(parameters, "p1=[0.5,1] or p1=0.9", "--parameter"),
        blocks=blocks,
        whole_recordings=whole_recordings,
        test_on=test_on,
        in_sample_only=in_sample_only,
        together=together,
        fleet=fleet,
        by_tag=by_tag,
        workers=workers,
        jobs=jobs,
        storage=storage,
        overrides=overrides,
    )
    notes = list(dict.fromkeys(note for made in searches for note in made.notes))
    for note in notes[:_MANY]:
        options.warn(note)
    if len(notes) > _MANY:
        options.warn(f"{len(notes) - _MANY} more of these, see `notes` in study.json")
    _say_what_is_searched(searches)
    folders = ", ".join(str(made.directory) for made in searches[:3])
    folders += ", ..." if len(searches) > 3 else ""
    try:
        documents = search_all(searches, jobs=cluster or jobs or _cores(), workers=workers)
    except KeyboardInterrupt:
        place = "the storage" if storage else folders
        raise KeyboardInterrupt(
            f"complete trials are kept in {place}; repeat the command to go on"
        ) from None
    parts = _parts(documents, in_one_table=style == "csv")
    said = (study_tables.importance_line(read_trials(made.directory)) for made in searches)
    parts += [*filter(None, said), f"studies: {folders}; best.yaml: run it, or `include:` it"]
    click.echo(page(parts, style, wide))
    if not no_figures:
        for made in searches:
            draw_study(made.directory)
    if json_file:
        write_json(json_file, {"schema_version": SCHEMA_VERSION, "studies": documents})


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _say_what_is_searched(searches: Sequence[Search]) -> None:
    """Two lines or so for each search space, those of equal studies once."""
    alike: dict[str, list[str]] = {}
    for made in searches:
        for name, space in made.spaces:
            searched, fixed = described(space)
            text = _wrapped(f"{len(space)} numbers are searched", searched)
            text += _wrapped(f"{space.n_fixed} are held fixed", fixed)
            alike.setdefault(text, []).append(name)
    for text, names in alike.items():
        click.echo((f"{', '.join(names)}:\n" if len(alike) > 1 else "") + text, nl=False, err=True)


def _wrapped(title: str, items: Sequence[str]) -> str:
    """Lines that break between the items."""
    text = f"{title}: " + ", ".join(item.replace(" ", "\0") for item in items)
    return textwrap.fill(text, line_width(), subsequent_indent="  ").replace("\0", " ") + "\n"


def _parts(documents: Sequence[Mapping[str, Any]], in_one_table: bool) -> list[str | Table]:
    parts: list[str | Table] = []
    by_title = {"": documents} if in_one_table else study_tables.by_country(documents)
    for title, mine in by_title.items():
        score = next(iter(mine[0]["best"]["values"]))
        shown = score if score in study_tables.scores_of(mine[0]) else "accuracy"
        parts += [title, Table(*study_tables.parameter_rows(mine, shown), labels=2)]
    if len(documents) == 1:
        parts.append(Table(*study_tables.score_rows(documents[0])))
    for document in documents:
        rows = study_tables.drive_rows(document)
        if rows:
            parts += [f"{document['name']}, held out:", Table(*fleet_table_rows(rows))]
    return [*parts, study_tables.legend(documents)]
