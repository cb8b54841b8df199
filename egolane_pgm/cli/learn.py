"""The command `egolane learn`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from egolane_pgm.api.learned import FleetLearnResult, LearnResult, learn_fleet
from egolane_pgm.api.learned import learn as learn_experiment
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.experiment import load_experiment
from egolane_pgm.learning import output_files
from egolane_pgm.report.fleet_table import fleet_table_rows
from egolane_pgm.report.tables import Table, page, score_rows
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.types import InputError


@click.command()
@options.experiment
@options.overrides()
@click.option(
    "--unlabelled", is_flag=True, help="Look at no label (learning.labels=false); for tables."
)
@click.option(
    "--out",
    type=click.Path(dir_okay=False),
    help="The new experiment; default learned_<name>.yaml here.",
)
@click.option(
    "--blocks",
    type=click.IntRange(2),
    default=5,
    show_default=True,
    help="Blocks held out in turn; of a fleet parts of its drives.",
)
@options.fleet
@options.by_tag
@options.jobs
@options.tables
@options.json_file
def learn(
    experiment: str,
    overrides: tuple[str, ...],
    unlabelled: bool,
    out: str | None,
    blocks: int,
    fleet: str | None,
    by_tag: str | None,
    jobs: Jobs,
    style: str,
    wide: bool,
    json_file: Path | None,
) -> None:
    """Learn an experiment from its recording: a new experiment, and what it is worth held out.

    An evidence rule that can learn (line_geometry) learns its parameters from the labels; with any
    other the tables of the graph are learned by EM, from lines and labels, or from lines alone.
    They are written in numbers, as a YAML graph beside the new experiment. Each block is scored
    with what was learned from the frames of the other blocks.

    With --fleet it is learned from all drives of a table together, and each part of the drives is
    scored with what was learned from the others.
    """
    if unlabelled:
        overrides = (*overrides, "learning.labels=false")
    found = load_experiment(experiment, overrides)
    target = Path(out) if out else Path(f"learned_{found.name.removeprefix('learned_')}.yaml")
    files = output_files(found, target)
    learned: LearnResult | FleetLearnResult
    if fleet is None:
        if by_tag is not None or jobs != 1:
            raise InputError("learn: --by-tag, --jobs and --cluster go with --fleet")
        learned = learn_experiment(found, blocks=blocks)
        parts, document = _parts(learned), _document(learned)
    else:
        for file in (*files, *filter(None, [json_file])):
            check_not_read(file, [Path(fleet)])
        learned = learn_fleet(
            found, fleet, overrides=overrides, blocks=blocks, by_tag=by_tag, jobs=jobs
        )
        parts, document = _fleet_parts(learned), _fleet_document(learned)
    for note in learned.notes:
        options.warn(note)
    # The scores are printed even if the files cannot be written.
    click.echo(page(parts, style, wide))
    files = learned.write(target)
    click.echo(f"\nwritten to {' and '.join(map(str, files))}", err=style != "markdown")
    if json_file:
        tables = document.pop("tables")
        parameters = {**load_experiment(target).parameters, **tables}
        write_json(json_file, {**document, "parameters": parameters})


def _document(done: LearnResult) -> dict[str, Any]:
    """What `egolane learn --json` writes, and the tables that were learned."""
    learned = done.learned
    before, after = learned.log_evidence or (None, None)
    return {
        "schema_version": SCHEMA_VERSION,
        "name": done.name,
        "blocks": done.blocks,
        "held_out": learned.scores,
        "held_out_all_frames": learned.scores_all,
        "log_evidence_before": before,
        "log_evidence_held_out": after,
        "tables": learned.tables(),
    }


def _fleet_document(done: FleetLearnResult) -> dict[str, Any]:
    """The same of a fleet: `held_out` are words, and `drives` the rows with the scores."""
    before, after = done.learned.log_evidence or (None, None)
    return {
        "schema_version": SCHEMA_VERSION,
        "name": done.name,
        "fleet": done.source,
        "held_out": done.held_out,
        "drives": list(done.rows),
        "log_evidence_before": before,
        "log_evidence_held_out": after,
        "tables": done.learned.tables(),
    }


def _fleet_parts(done: FleetLearnResult) -> list[str | Table]:
    title = f"{done.name}: learned from {done.source}\nheld out: {done.held_out}"
    parts: list[str | Table] = [title, Table(*fleet_table_rows(done.rows))]
    if not any(row["frames_scored"] for row in done.rows):
        parts = [f"{title}\nno ground truth, so nothing is scored"]
    return parts + _log_evidence_parts(done.learned.log_evidence)


def _parts(done: LearnResult) -> list[str | Table]:
    learned = done.learned
    parts: list[str | Table] = []
    if learned.scores is None or learned.scores_all is None:
        parts.append(f"{done.name}: no ground truth, so nothing is scored; {done.blocks} blocks")
    else:
        scored, everywhere = learned.scores["frames_scored"], learned.scores_all["frames_scored"]
        said = f"{done.name}: held out, {done.blocks} blocks, {scored} frames scored"
        if learned.tables():
            said += "\neach with tables for which neither its labels nor its lines were looked at"
        parts += [said, Table(*score_rows({"model": learned.scores}))]
        if everywhere != scored:
            parts.append(f"the same over all {everywhere} frames, those of tuning.never_fit too")
            parts.append(Table(*score_rows({"model": learned.scores_all})))
    return parts + _log_evidence_parts(learned.log_evidence)


def _log_evidence_parts(log_evidence: tuple[float, float] | None) -> list[str | Table]:
    if log_evidence is None:
        return []
    before, after = log_evidence
    return [
        f"log evidence per frame, exact filter: {before:.4f} with the starting tables,"
        f" {after:.4f} with the learned ones, held out"
    ]
