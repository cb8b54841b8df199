"""The command `egolane studies`, and what `egolane tune` does with a storage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from egolane_pgm.tune.address import Address
    from egolane_pgm.tune.tuning import Progress

_STORAGE_HELP = "postgresql+psycopg://user@host/database; also EGOLANE_STORAGE."


def storage_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that name a storage."""
    for option in (
        click.option(
            "--password-file",
            type=click.Path(),
            metavar="FILE",
            help="As libpq's .pgpass: host:port:database:user:password.",
        ),
        click.option("--storage", metavar="URL", help=_STORAGE_HELP),
    ):
        command = option(command)
    return command


def address_of(storage: str | None, password_file: str | None) -> Address:
    """The storage that is named, its password out of the list of processes."""
    from egolane_pgm.tune.address import find_address, hide_command_line

    address = find_address(storage, password_file)
    hide_command_line(address)
    return address


def is_named(storage: str | None) -> bool:
    """Whether an option or the environment names a storage."""
    import os

    return bool(storage or os.environ.get("EGOLANE_STORAGE"))


def check_alone(allowed: Sequence[str]) -> None:
    """Raise InputError where the command was given more than `--join` has a use for: what a study
    is, whoever began it has said."""
    from click.core import ParameterSource

    from egolane_pgm.types import InputError

    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        if name in allowed or context.get_parameter_source(name) is ParameterSource.DEFAULT:
            continue
        shown = "EXPERIMENTS" if name == "experiments" else parameter.opts[0]
        raise InputError(f"--join: takes the study as it was begun; leave {shown} away")


def join_studies(
    names: Sequence[str], address: Address, workers: int, progress: Progress
) -> list[str]:
    """Join studies one after the other; what became of each, a line."""
    from egolane_pgm.tune.joining import join

    return [f"{name}: {join(name, address, workers, progress).line()}" for name in names]


@click.command()
@storage_options
@click.option(
    "--export", nargs=2, metavar="STUDY FILE", help="Write a study to FILE: .db or .journal."
)
@click.option(
    "--format",
    "style",
    type=click.Choice(["markdown", "latex", "csv"]),
    default="markdown",
    show_default=True,
)
@click.option("--json", "json_file", type=click.Path(dir_okay=False), metavar="FILE")
def studies(
    storage: str | None,
    password_file: str | None,
    export: tuple[str, str] | None,
    style: str,
    json_file: str | None,
) -> None:
    """List the studies of a PostgreSQL storage: progress, rate, workers alive, best score so far.

    The best score is in-sample: on the frames that the search saw.
    """
    from dataclasses import asdict

    from egolane_pgm.results import SCHEMA_VERSION, check_place, write_json
    from egolane_pgm.tune._connection import Link
    from egolane_pgm.tune.exporting import export_study
    from egolane_pgm.tune.postgres import list_studies

    if json_file:
        check_place(Path(json_file))
    link = Link(address_of(storage, password_file))
    try:
        if export is not None:
            count = export_study(link, export[0], Path(export[1]))
            click.echo(f"{export[1]}: {count} trials of {export[0]}")
            return
        listed = list_studies(link)
    finally:
        link.close()
    _print(listed, style)
    if json_file:
        content = {"schema_version": SCHEMA_VERSION, "studies": [asdict(s) for s in listed]}
        write_json(Path(json_file), content)


def _print(listed: Sequence[Any], style: str) -> None:
    from egolane_pgm.report import tables as text

    draw = {"markdown": text.markdown, "latex": text.latex, "csv": text.as_csv}[style]
    header = (
        *("study", "finished", "asked", "running", "lost"),
        *("trials/s", "workers alive", "best", "score, in-sample"),
    )
    rows = [
        (
            *(s.name, str(s.finished), str(s.asked), str(s.running), str(s.lost)),
            *("-" if s.rate is None else f"{s.rate:.1f}", str(s.workers)),
            *("-" if s.best is None else f"{s.best:.4f}", s.objective),
        )
        for s in listed
    ]
    if not rows and style == "markdown":
        click.echo("no studies yet; start one with `egolane tune EXPERIMENT --storage ...`")
        return
    click.echo(draw(header, rows).rstrip("\n"))
