"""The command `egolane learn`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from egolane_pgm.cli import options
from egolane_pgm.comparing.choose import chosen_on_all, learns, plan, try_all
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.files import write_json
from egolane_pgm.learning import Learned, output_files, write_learned
from egolane_pgm.learning import learn as run_learn
from egolane_pgm.loading import with_video_rate
from egolane_pgm.model import prepare_model
from egolane_pgm.report.tables import scores_table
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
@options.json_file
def learn(
    experiment: str,
    overrides: tuple[str, ...],
    unlabelled: bool,
    out: str | None,
    blocks: int,
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
    name = f"learned_{found.name.removeprefix('learned_')}"
    target = Path(out) if out else Path(f"{name}.yaml")
    output_files(found, target)
    # The written experiment names the frame rate that was used.
    given = with_video_rate(found)
    found = _chosen(given, blocks)
    if not _learns_more(given):
        _write_chosen(found, target, blocks, json_file)
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        with tqdm(total=blocks + 1, unit="fit", leave=False, disable=None) as bar:
            learned = run_learn(found, n_blocks=blocks, done=bar.update)
    # Several blocks may give the same warning.
    for note in dict.fromkeys(str(w.message) for w in caught):
        click.echo(f"warning: {note}", err=True)
    # The scores are printed even if the files cannot be written.
    _print(found.name, learned, blocks)
    files = write_learned(found, learned.model, learned.parameters, target)
    click.echo(f"\nwritten to {' and '.join(map(str, files))}")
    if json_file:
        write_json(
            json_file,
            {
                "schema_version": SCHEMA_VERSION,
                "name": found.name,
                "blocks": blocks,
                "held_out": _plain(learned.scores),
                "held_out_all_frames": _plain(learned.scores_all),
                "log_evidence_before": learned.log_evidence and learned.log_evidence[0],
                "log_evidence_held_out": learned.log_evidence and learned.log_evidence[1],
                "parameters": {**load_experiment(target).parameters, **learned.tables()},
            },
        )


def _chosen(experiment: Experiment, blocks: int) -> Experiment:
    """The experiment, with its constants chosen if it says `fit: choose`."""
    if experiment.fit != "choose":
        return experiment

    (tasks,) = plan([experiment], blocks, is_held_out=False).values()
    bar = tqdm(try_all(tasks), "choosing", len(tasks), unit="recording", leave=False, disable=None)
    found = chosen_on_all(experiment, list(bar))
    assert experiment.choice is not None
    said = ", ".join(f"{name} {found.parameters[name]}" for name in experiment.choice.grid)
    what = "nothing else is learned"
    if _learns_more(experiment):
        what = "the scores below have seen that choice"
    click.echo(
        f"chosen on all blocks: {said}; {what}, `egolane compare` chooses without each block that"
        " it scores"
    )
    return found


def _learns_more(experiment: Experiment) -> bool:
    """Whether anything is learned beside the choice: with `fit: choose`, as in `compare`, tables
    are learned only if the experiment has a section `learning`."""
    return experiment.fit != "choose" or learns(prepare_model(experiment), experiment)


def _write_chosen(
    experiment: Experiment, target: Path, blocks: int, json_file: Path | None
) -> None:
    """Write an experiment whose constants were chosen; it has no held-out scores."""
    files = write_learned(experiment, prepare_model(experiment), {}, target)
    click.echo(f"\nwritten to {' and '.join(map(str, files))}")
    if json_file:
        content: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "name": experiment.name}
        content |= {"blocks": blocks, "parameters": dict(experiment.parameters)}
        none = ("held_out", "held_out_all_frames", "log_evidence_before", "log_evidence_held_out")
        write_json(json_file, {**content, **dict.fromkeys(none)})


def _print(name: str, learned: Learned, blocks: int) -> None:
    if learned.scores is None or learned.scores_all is None:
        click.echo(f"{name}: no ground truth, so nothing is scored; {blocks} blocks")
    else:
        scored, everywhere = learned.scores["frames_scored"], learned.scores_all["frames_scored"]
        click.echo(f"{name}: held out, {blocks} blocks, {scored} frames scored")
        if learned.tables():
            click.echo("each with tables for which neither its labels nor its lines were looked at")
        click.echo(scores_table({"model": learned.scores}))
        if everywhere != scored:
            click.echo(f"\nthe same over all {everywhere} frames, those of tuning.never_fit too")
            click.echo(scores_table({"model": learned.scores_all}))
    if learned.log_evidence is not None:
        before, after = learned.log_evidence
        click.echo(
            f"\nlog evidence per frame, exact filter: {before:.4f} with the starting tables,"
            f" {after:.4f} with the learned ones, held out"
        )


def _plain(scores: Any) -> Any:
    return None if scores is None else dict(scores)
