"""The command `egolane learn`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from egolane_pgm.api.learned import LearnResult
from egolane_pgm.api.learned import learn as learn_experiment
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.experiment import load_experiment
from egolane_pgm.learning import output_files
from egolane_pgm.report.tables import Table, page, score_rows
from egolane_pgm.results import SCHEMA_VERSION


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
@click.option("--blocks", type=click.IntRange(2), default=5, show_default=True)
@options.tables
@options.json_file
def learn(
    experiment: str,
    overrides: tuple[str, ...],
    unlabelled: bool,
    out: str | None,
    blocks: int,
    style: str,
    wide: bool,
    json_file: Path | None,
) -> None:
    """Learn an experiment from its recording: a new experiment, and what it is worth held out.

    An evidence rule that can learn (line_geometry) learns its parameters from the labels; with any
    other the tables of the graph are learned by EM, from lines and labels, or from lines alone.
    They are written in numbers, as a YAML graph beside the new experiment. Each block is scored
    with what was learned from the frames of the other blocks.

    With `fit: choose` constants are chosen first, and tables learned only where the experiment has
    a `learning` section, as in `egolane compare`.
    """
    if unlabelled:
        overrides = (*overrides, "learning.labels=false")
    found = load_experiment(experiment, overrides)
    target = Path(out) if out else Path(f"learned_{found.name.removeprefix('learned_')}.yaml")
    output_files(found, target)
    learned = learn_experiment(found, blocks=blocks)
    for note in learned.notes:
        options.warn(note)
    # The scores are printed even if the files cannot be written.
    click.echo(page(_parts(learned), style, wide))
    files = learned.write(target)
    click.echo(f"\nwritten to {' and '.join(map(str, files))}", err=style != "markdown")
    if json_file:
        write_json(json_file, _document(learned, load_experiment(target).parameters))


def _document(done: LearnResult, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """What `egolane learn --json` writes."""
    learned = done.learned
    before, after = (learned and learned.log_evidence) or (None, None)
    return {
        "schema_version": SCHEMA_VERSION,
        "name": done.name,
        "blocks": done.blocks,
        "held_out": learned and learned.scores,
        "held_out_all_frames": learned and learned.scores_all,
        "log_evidence_before": before,
        "log_evidence_held_out": after,
        "parameters": {**parameters, **(learned.tables() if learned else {})},
    }


def _parts(done: LearnResult) -> list[str | Table]:
    learned = done.learned
    parts: list[str | Table] = []
    if done.chosen:
        said = ", ".join(f"{name} {value}" for name, value in done.chosen.items())
        what = "the scores below have seen that choice" if learned else "nothing else is learned"
        parts.append(
            f"chosen on all blocks: {said}; {what}, `egolane compare` chooses without each block"
            " that it scores"
        )
    if learned is None:
        return parts
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
    if learned.log_evidence is not None:
        before, after = learned.log_evidence
        parts.append(
            f"log evidence per frame, exact filter: {before:.4f} with the starting tables,"
            f" {after:.4f} with the learned ones, held out"
        )
    return parts
