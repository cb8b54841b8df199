"""The command `egolane report`."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.report.page.document import write_page
from egolane_pgm.results import Result, is_result, read_result
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError

#: The page of a result, in its directory; of several, in the current folder.
PAGE = "report.html"


@click.command()
@click.argument("results", nargs=-1, required=True, type=click.Path())
@click.option(
    "-o",
    "--out",
    "target",
    metavar="FILE.html",
    help=f"Default: {PAGE} in the result's directory; of several, here.",
)
@click.option("--open", "is_opened", is_flag=True, help="Show the page in the browser.")
def report(results: tuple[str, ...], target: str | None, is_opened: bool) -> None:
    """Write one HTML page of RESULT directories: an interactive timeline, scores, the worst
    stretches, lane changes, parameters and where the numbers come from.

    The page needs no network and no other file. Several results stand side by side on one time
    axis.
    """
    read = [_read(path) for path in results]
    if target is None:
        file = Path(results[0]) / PAGE if len(results) == 1 else Path(PAGE)
    else:
        file = Path(target)
        if file.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"--out {target}: a page ends in .html")
    check_place(file)
    for line in write_page(read, file):
        click.echo(f"warning: {line}", err=True)
    click.echo(f"{options.shown(file)}: {file.stat().st_size / 1e6:.1f} MB")
    if is_opened and not webbrowser.open(file.absolute().as_uri()):
        raise InputError(f"--open: no browser was found; open {file.absolute()} yourself")


def _read(path: str) -> Result:
    """The result in a directory. Raises InputError for what is none, which says what to give
    instead."""
    place = Path(path)
    if not path or not place.exists():
        raise InputError(f"{path or 'report'}: is not there; name a result directory")
    if place.is_dir() and not is_result(place):
        if (place / "study.json").is_file():
            raise InputError(
                f"{path}: is a study of parameters, which `egolane plot` draws; run the experiment"
                " that it wrote and report on that result"
            )
        inside = _results_in(place)
        if inside:
            shown = " ".join(map(str, inside[:4])) + (" ..." if len(inside) > 4 else "")
            raise InputError(
                f"{path}: is a folder of {len(inside)} result(s); name those that you mean:"
                f" egolane report {shown}"
            )
    return read_result(place)


def _results_in(folder: Path) -> list[Path]:
    """The result directories in a folder, and in those that `compare` made in it."""
    children = sorted(child for child in folder.iterdir() if child.is_dir())
    grandchildren = (each for child in children for each in sorted(child.iterdir()))
    return [each for each in (*children, *grandchildren) if each.is_dir() and is_result(each)]
