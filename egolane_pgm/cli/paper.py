"""The command `egolane reproduce`: the paper's own runs."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm import paper
from egolane_pgm.api.reproduction import reproduce as reproduce_runs
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.cli.recordings import have_recordings
from egolane_pgm.report.tables import Table, confusion_table, page


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
