"""The command `egolane plot`."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm.report.draw import draw_standard, draw_together
from egolane_pgm.report.study_figures import draw_study
from egolane_pgm.report.study_trials import is_study
from egolane_pgm.results import read_result
from egolane_pgm.types import InputError


@click.command()
@click.argument("results", nargs=-1, required=True, type=click.Path(file_okay=False))
@click.option(
    "--frames", type=(int, int), metavar="FIRST LAST", help="Frame ids of the belief strips."
)
@click.option("--out", type=click.Path(file_okay=False), help="Default: figures/ in the result.")
@click.option("--style", type=click.Choice(["png", "pdf", "svg"]), default="png", show_default=True)
def plot(
    results: tuple[str, ...], frames: tuple[int, int] | None, out: str | None, style: str
) -> None:
    """Draw the figures of result directories, and of those that `egolane tune` leaves; several
    results together make one dispersion sheet."""
    drives = [Path(path) for path in results if not is_study(path)]
    if frames and len(drives) < len(results):
        raise InputError("--frames: goes with results; the figures of a study have no frames")
    for path in results:
        folder = Path(path)
        target = Path(out) / folder.name if out and len(results) > 1 else Path(out or "")
        target = target if out else folder / "figures"
        if folder in drives:
            files = draw_standard(read_result(folder), target, frames=frames, style=style)
        else:
            files = draw_study(folder, target, style=style)
        for file in files:
            click.echo(file)
    if len(drives) > 1:
        target = Path(out) if out else drives[0].parent
        for file in draw_together(drives, target, style=style):
            click.echo(file)
