"""The commands of `egolane` about the paper's own runs: reproduce and recover."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm import paper
from egolane_pgm.api.reproduction import reproduce as reproduce_runs
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.cli.recordings import have_recordings
from egolane_pgm.report.tables import Table, confusion_table, page
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.tools.progress import bar
from egolane_pgm.tuning import recover as recovering


@click.command()
@click.option("--runs", default="1-10", show_default=True, help="E.g. 1-5,7.")
@options.parameters()
@options.tables
@click.option("--matrices", is_flag=True, help="Print every confusion matrix too.")
@click.option(
    "--if-available",
    is_flag=True,
    help="Without the recordings: offer the download, or say how to get them, and end well.",
)
@click.option("--out", type=click.Path(file_okay=False), help="Keep a result directory per run.")
@options.json_file
def reproduce(
    runs: str,
    which: str,
    style: str,
    wide: bool,
    matrices: bool,
    if_available: bool,
    out: str | None,
    json_file: Path | None,
) -> None:
    """The paper's ten runs: ours beside the 20 published tables, and the difference."""
    numbers = paper.parse_runs(runs)
    if if_available and not have_recordings():
        return
    done = reproduce_runs(runs=numbers, parameters=which, out=out)
    document = done.document
    parts: list[str | Table] = [Table(*done.rows(), labels=2, leaves_out=True)]
    if matrices:
        parts += [
            confusion_table(entry[kind]["confusion"], f"run {entry['run']}, {kind}")
            for entry in document["runs"]
            for kind in ("detector", "model")
        ]
    parts.append(
        f"{document['total_frames_off']} of {done.n_classified} classified frames differ from"
        f" the published matrices (parameters: {which}; in-sample, as in the paper)"
    )
    click.echo(page(parts, style, wide))
    if json_file:
        write_json(json_file, document)


@click.command()
@click.option("--run", "number", type=int, required=True, help="Which of the paper's runs.")
@click.option("--evaluations", type=click.IntRange(1), default=20_000, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--write", is_flag=True, help="Keep the set in published.yaml under `recovered`.")
@options.json_file
def recover(number: int, evaluations: int, seed: int, write: bool, json_file: Path | None) -> None:
    """Search the published, truncated parameters' box for the values that were really used."""
    paper.paper_experiment(number)
    with bar(total=evaluations, desc=f"run {number}", unit="trial") as shows:

        def progress(more: int, off: int) -> None:
            shows.update(more)
            shows.set_postfix(frames_off=off)

        found = recovering.recover(number, evaluations=evaluations, seed=seed, progress=progress)
    values = ", ".join(f"{k}: {v!r}" for k, v in found.parameters.items())
    click.echo(f"run {number}: {found.frames_off} frames off after {found.evaluations} evaluations")
    click.echo(f"{{{values}}}")
    if write:
        how = f"an Optuna study in the box of the truncated values, sampler Shade, seed {seed}"
        recovering.store_recovered(number, found, how)
        click.echo(f"written to {options.shown(paper.published_path())}")
    if json_file:
        write_json(
            json_file,
            {
                "schema_version": SCHEMA_VERSION,
                "run": number,
                "frames_off": found.frames_off,
                "evaluations": found.evaluations,
                "seed": seed,
                "parameters": dict(found.parameters),
            },
        )
