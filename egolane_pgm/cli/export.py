"""The command `egolane export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.export.drive import Drive, open_drive
from egolane_pgm.export.layouts import LAYOUTS, write_layout
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError


@click.command()
@click.argument("result", type=click.Path())
@click.argument("target", type=click.Path(dir_okay=False))
@click.option(
    "--pictures",
    metavar="PICTURES",
    help="A video, a folder or a 'glob*.jpg'.  [default: those that the result's detector saw]",
)
@options.frames
@click.option(
    "--layout",
    "layouts",
    multiple=True,
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write a layout, too: .json of Foxglove, .xml of PlotJuggler.",
)
def export(
    result: str,
    target: str,
    pictures: str | None,
    frames: tuple[int, int] | None,
    layouts: tuple[str, ...],
) -> None:
    """Write a result for a viewer: TARGET is out.mcap for Foxglove and PlotJuggler, or out.rrd for
    rerun.

    Lines, the view from above, beliefs, answers, truth and pictures are on one clock.

    \b
    egolane export results/quickstart out.mcap --layout foxglove.json
    egolane export results/quickstart out.rrd
    """
    write = _writer(Path(target))
    for name in layouts:
        if Path(name).suffix.lower() not in LAYOUTS:
            known = ", ".join(f"{ending} ({program})" for ending, program in LAYOUTS.items())
            raise InputError(f"--layout {name}: unknown extension; take {known}")
        if target.lower().endswith(".rrd"):
            raise InputError(f"--layout {name}: goes with .mcap; an .rrd has its layout in it")
    if frames is not None and frames[0] >= frames[1]:
        raise InputError(f"--frames {frames[0]} {frames[1]}: is an empty range")
    for file in (target, *layouts):
        check_place(Path(file))
    drive = open_drive(result, pictures=pictures, frames=frames)
    counts = write(Path(target), drive)
    said = ", ".join(f"{topic} {n}" for topic, n in sorted(counts.items()))
    click.echo(f"{target}: {len(drive)} frames ({said})")
    for name in layouts:
        write_layout(Path(name), drive)
        click.echo(f"{name}: layout of {LAYOUTS[Path(name).suffix.lower()]}")


def _writer(target: Path) -> Callable[[Path, Drive], dict[str, int]]:
    ending = target.suffix.lower()
    if ending == ".mcap":
        from egolane_pgm.export.mcap_file import write_mcap

        return write_mcap
    if ending == ".rrd":
        from egolane_pgm.export.rerun_file import write_rrd

        return write_rrd
    raise InputError(
        f"{target}: unknown extension; take .mcap (Foxglove, PlotJuggler), .rrd (rerun)"
    )
