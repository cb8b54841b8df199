"""The arguments and options that several commands share, each declared once."""

from __future__ import annotations

import contextlib
import functools
import io
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from egolane_pgm.cli.completion import plugins
from egolane_pgm.experiment import read_override
from egolane_pgm.tools import files
from egolane_pgm.tools.files import check_place, json_text
from egolane_pgm.types import MAX_LANES, NOTE, InputError, in_one_line

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

experiment = click.argument("experiment", type=click.Path(dir_okay=False))


def experiments(*, required: bool, folders: bool = False) -> Decorator:
    """Several experiments; with `folders` they may be result directories too."""
    return click.argument(
        "experiments",
        nargs=-1,
        required=required,
        type=click.Path(dir_okay=folders),
    )


#: What completes the name of a detector.
detectors = plugins("detectors")


def tables(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a command that prints tables."""
    wide = click.option(
        "--wide",
        is_flag=True,
        help="Whole tables, for a file, not only what fits the terminal (or COLUMNS, or 80).",
    )
    style = click.option(
        "--format",
        "style",
        type=click.Choice(["markdown", "latex", "csv"]),
        default="markdown",
        show_default=True,
        help="Of the tables; csv is the first one alone, one number in a cell.",
    )
    return style(wide(command))


cluster = click.option(
    "--cluster",
    metavar="ADDRESS|local:N",
    help="Instead of --jobs: the scheduler of a Dask cluster, or one of N processes here.",
)


def jobs(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--jobs N`, or `--cluster ADDRESS` instead: where work is shared out to, as `jobs`."""

    @functools.wraps(command)
    def with_jobs(*args: Any, jobs: int, cluster: str | None, **kwargs: Any) -> Any:
        return command(*args, jobs=jobs if cluster is None else cluster, **kwargs)

    return click.option(
        "--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes."
    )(cluster(with_jobs))


fleet = click.option(
    "--fleet",
    metavar="FILE",
    help="A table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...",
)

by_tag = click.option(
    "--by-tag",
    metavar="NAME",
    help="With --fleet: hold out the drives with each value of tag.NAME in turn.",
)

camera = click.option(
    "--camera", "camera_file", required=True, metavar="FILE", help="The camera's YAML."
)


def of_recording(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a recording that is named on the command line, in this order."""
    in_order = (
        click.option("--camera", metavar="FILE", help="Its camera: for pictures, lines in pixels."),
        click.option(
            "--detector",
            metavar="NAME|FILE.py",
            shell_complete=detectors,
            help="What looks at the video.",
        ),
        click.option(
            "--frame-id",
            type=click.Choice(["way_id", "seq", "count"]),
            help="What of a bag's messages is the frame id; count: their order.",
        ),
    )
    # Help lists the option that is added last first.
    for option in reversed(in_order):
        command = option(command)
    return command


right = click.option(
    "--right", "right_pictures", metavar="PICTURES", help="Those of the second camera."
)

frames = click.option(
    "--frames", type=(int, int), metavar="FIRST STOP", help="Frame ids, STOP left out."
)


def overrides(
    help: str = "Override a key of the YAML, e.g. parameters.bonus_value=0.",
) -> Decorator:
    """`--set KEY=VALUE`, which may be given several times. A file is found from where one stands,
    or else beside the YAML."""
    return click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help=help)


def parameters(
    help: str = "Recovered (by a search; run 5 from the authors' code), or as printed (truncated).",
) -> Decorator:
    """`--parameters`, for each of the paper's runs recovered or as published."""
    return click.option(
        "--parameters",
        "which",
        type=click.Choice(["recovered", "published"]),
        default="recovered",
        show_default=True,
        help=help,
    )


def _writable(_: click.Context, __: click.Parameter, file: str | None) -> Path | None:
    """Check that the file can be written, before anything is computed. With `-` nothing but the
    JSON comes to standard output from here on."""
    if file is None:
        return None
    if file == "-":
        context = click.get_current_context()
        context.meta[__name__] = sys.stdout
        context.with_resource(contextlib.redirect_stdout(io.StringIO()))
    else:
        check_place(Path(file))
    return Path(file)


def write_json(file: Path, content: Mapping[str, Any]) -> None:
    """Write what `--json` is about. Raises InputError where it cannot be written."""
    if str(file) == "-":
        click.echo(json_text(content), file=click.get_current_context().meta[__name__], nl=False)
    else:
        files.write_json(file, content)


def _a_road(_: click.Context, __: click.Parameter, n_lanes: int) -> int:
    if n_lanes > MAX_LANES:
        raise InputError(f"--n-lanes: {n_lanes} is more than {MAX_LANES}")
    return n_lanes


n_lanes = click.option(
    "--n-lanes", type=click.IntRange(1), default=3, show_default=True, callback=_a_road
)

json_file = click.option(
    "--json",
    "json_file",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    callback=_writable,
    help="Write the unrounded numbers as JSON; - prints them, and nothing else.",
)


def warn(text: str, title: str = "") -> None:
    """Print a warning, or a note, on standard error: what is about something that has a title."""
    kind, said = (NOTE, text.removeprefix(NOTE)) if text.startswith(NOTE) else ("warning: ", text)
    click.echo(in_one_line(f"{kind}{title and title + ': '}{said}"), err=True)


def failed(title: str, problem: str) -> None:
    """Print on standard error what is wrong with one of several."""
    click.echo(in_one_line(f"failed: {title}: {problem}"), err=True)


def shown(path: Path) -> str:
    """A path as it is printed: relative where it lies in the current folder."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def given(overrides: Iterable[str], example: str, option: str = "--set") -> dict[str, Any]:
    """The keys and values of an option that may be given several times. Raises InputError, with
    the example, for one that has no key or no value."""
    return dict(read_override(override, example, option) for override in overrides)
