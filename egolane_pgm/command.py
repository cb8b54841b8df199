"""The command `egolane`, made from the functions in `egolane_pgm.verbs`.

A verb's parameters before the `*` become arguments, the others options. Types give the checks, the
docstring gives the help, and `tools.options.Option` the rest. A verb's module may also define:

- `text(done, style)`: the output, if the object that a verb returns has no `to_text`.
- `summary(done, given)`: the last lines of the output, such as the path of a result.

If a verb returns a table whose column `error` is not empty, the exit code is 1.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import re
import sys
import types
import typing
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from egolane_pgm import __version__

#: Commands by purpose, with their short help. A verb is imported only if its command is used.
GROUPS = {
    "Run": {
        "run": "Infer the lane in a recording, score it, write a result directory.",
        "online": "Filter frame by frame: JSON lines in, the lane out at once.",
        "compare": "Compare results, with paired intervals.",
        "reproduce": "Repeat the paper's ten runs and compare with its tables.",
    },
    "Search": {
        "tune": "Search parameters; score them on held-out frames.",
        "learn": "Fit a model to its recording; score it on held-out frames.",
        "explore": "Search the edges of a graph: which one helps?",
    },
    "Look": {
        "plot": "Draw results and studies: figures, a page, a video, an MCAP file.",
        "show": "List or describe graphs, evidence rules, detectors, experiments.",
        "label": "Label the lanes of a recording; list the uncertain segments.",
    },
    "Prepare": {
        "detect": "Detect and track lane lines in the pictures of a camera.",
        "calibrate": "Calibrate a camera from pictures of boards and roads.",
        "locate": "Match positions to the roads of a map.",
        "simulate": "Simulate a drive, as lines or as pictures.",
        "data": "List, check and download the paper's recordings.",
    },
}

#: The short help of each command.
COMMANDS = {name: help for group in GROUPS.values() for name, help in group.items()}

#: Commands that print wide tables (`--format`), and those with `--json`.
WITH_TABLES = ("run", "compare", "reproduce")
WITH_JSON = (*WITH_TABLES, "show")

#: The options of commands that print tables and numbers.
_TABLES: list[click.Parameter] = [
    click.Option(
        ["--format", "table_style"],
        type=click.Choice(["markdown", "wide", "latex", "csv"]),
        default="markdown",
        show_default=True,
        help="Format of tables; all but markdown have all scores, csv is unrounded.",
    ),
]
_JSON = click.Option(
    ["--json", "json_file"],
    type=click.Path(),
    metavar="FILE",
    help="Write the unrounded numbers as JSON; - prints them only.",
)

#: The first word of a message, which may be the name of a parameter.
_LEADING = re.compile(r"^\w+(?=:)")


def main() -> None:
    """Run the command `egolane`."""
    egolane(prog_name="egolane")


# --- a command from a verb ---------------------------------------------------------------------


def command_of(name: str) -> click.Command:
    """Make the command of a verb."""
    from egolane_pgm.types import InputError

    module = import_module(f"egolane_pgm.verbs.{name}")
    verb = getattr(module, name)
    hints = typing.get_type_hints(verb, include_extras=True)
    text, helps = _docstring(inspect.getdoc(verb) or "")
    params = [
        _param(each, hints[each.name], helps.get(each.name, ""))
        for each in inspect.signature(verb).parameters.values()
        if not any(getattr(extra, "in_python", False) for extra in _parts_of(hints[each.name])[1])
    ]
    params += _TABLES * (name in WITH_TABLES) + [_JSON] * (name in WITH_JSON)
    names = {param.name: max(param.opts, key=len) for param in params}

    def callback(**values: Any) -> None:
        try:
            for key, value in values.items():
                if value == "" or (isinstance(value, tuple) and "" in value):
                    raise InputError(f"{key}: is empty")
            _invoke(verb, values, module)
        except InputError as error:
            # A parameter of the Python function is an option here.
            text = _LEADING.sub(lambda m: names.get(m[0], m[0]), str(error))
            raise InputError(text) from error

    examples = "\n".join(f"  {example}" for example in module.EXAMPLES)
    epilog = f"\b\nExamples:\n{examples}"
    return click.Command(name, callback=callback, params=params, help=text, epilog=epilog)


def _docstring(text: str) -> tuple[str, dict[str, str]]:
    """The help in a docstring: of the verb and of each parameter.

    What is for Python callers only is left out: what the verb returns and raises, and examples.
    """
    about: list[str] = []
    helps: dict[str, str] = {}
    for paragraph in text.split("\n\n"):
        if paragraph.startswith("- "):
            for item in re.split(r"\n(?=- )", paragraph):
                name, _, meaning = item.removeprefix("- ").partition(":")
                helps[name] = " ".join(meaning.split())
        elif not paragraph.startswith((">>>", "Returns ", "Raises ")):
            about.append(paragraph)
    return "\n\n".join(about), helps


def _parts_of(hint: Any) -> tuple[list[Any], list[Any]]:
    """The types in a hint, without None, and its annotations, the outermost first."""
    if typing.get_origin(hint) is typing.Annotated:
        kinds, extras = _parts_of(hint.__origin__)
        return kinds, [*reversed(hint.__metadata__), *extras]
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        parts = [_parts_of(part) for part in hint.__args__ if part is not types.NoneType]
        return [k for kinds, _ in parts for k in kinds], [e for _, extras in parts for e in extras]
    return [hint], []


def _param(parameter: inspect.Parameter, hint: Any, help: str) -> click.Parameter:
    """The argument or option of a verb's parameter."""
    from egolane_pgm.tools.options import Option

    name, default, (kinds, extras) = parameter.name, parameter.default, _parts_of(hint)
    option = next((extra for extra in extras if isinstance(extra, Option)), Option())
    is_needed = default is inspect.Parameter.empty
    is_list = any(typing.get_origin(kind) is Sequence for kind in kinds)
    is_many = is_list and not isinstance(default, str)
    kind = _type_of(kinds[0], kinds, extras)
    settings = {"metavar": option.metavar, "required": option.required or is_needed, "type": kind}
    value = default if option.default is None else option.default
    if value is not None and value != () and not is_needed:
        settings["default"] = value
    if parameter.kind is not inspect.Parameter.KEYWORD_ONLY:
        return click.Argument([name], nargs=-1 if is_many else 1, **settings)
    long = f"--{name.replace('_', '-')}"
    if default is True:
        flag = long.replace("--", "--no-")
        return click.Option([flag, name], flag_value=False, default=True, help=f"Do not {help}")
    names = option.names if any(n.startswith("--") for n in option.names) else (*option.names, long)
    settings |= {"is_flag": True} if kinds == [bool] else {"multiple": is_many}
    help = help[:1].upper() + help[1:]
    return click.Option(
        [*names, name], help=help, envvar=option.envvar, show_default=True, **settings
    )


def _type_of(first: Any, kinds: Sequence[Any], extras: Sequence[Any]) -> Any:
    """The type by which click checks a value."""
    kind, given = typing.get_origin(first), typing.get_args(first)
    if kind is typing.Literal:
        return click.Choice(given)
    if kind is Sequence:
        return _type_of(given[0], kinds, extras)
    if kind is tuple:
        return given
    if first in (int, float, bool):
        ends = {key: getattr(e, key) for e in extras for key in ("ge", "le") if hasattr(e, key)}
        ranged = click.IntRange if first is int else click.FloatRange
        return ranged(ends.get("ge"), ends.get("le")) if ends else first
    is_path = any(typing.get_origin(each) is os.PathLike for each in kinds)
    return click.Path() if is_path else str


# --- what a command does -----------------------------------------------------------------------


def _invoke(verb: Callable[..., Any], values: dict[str, Any], module: types.ModuleType) -> None:
    """Call a verb with the values of the command line, and print what it returns."""
    from egolane_pgm.tools.files import check_not_read, check_place, json_text, write_json
    from egolane_pgm.tools.options import several_of
    from egolane_pgm.types import printable

    tables = {"style": values.pop("table_style")} if "table_style" in values else {}
    json_file = values.pop("json_file", None)
    given = {name: value for name, value in values.items() if value != ()}
    is_data = tables.get("style") in ("latex", "csv")
    prints = io.StringIO() if json_file == "-" else sys.stdout
    if json_file not in (None, "-"):
        each_given = (v for value in given.values() for v in several_of(value))
        check_not_read(Path(json_file), [Path(v) for v in each_given if isinstance(v, str) and v])
        check_place(Path(json_file))
    with contextlib.redirect_stdout(prints):
        done = verb(**given)
        # The file is written before anything is printed: a reader may close the pipe.
        if json_file not in (None, "-"):
            write_json(Path(json_file), document_of(done))
        for note in getattr(done, "notes", ()):
            warn(note)
        printed = done
        if hasattr(done, "to_text"):
            printed = done.to_text(**tables)
        elif hasattr(module, "text"):
            printed = module.text(done, **tables)
        if isinstance(printed, str):
            click.echo(printable(printed))
        if hasattr(module, "summary") and not isinstance(done, str):
            end = printable(module.summary(done, given))
            click.echo(f"\n{end}" if isinstance(printed, str) else end, err=is_data)
    if json_file == "-":
        click.echo(json_text(document_of(done)), nl=False)
    failed = done["error"].dropna() if "error" in getattr(done, "columns", ()) else {}
    for title, why in failed.items():
        warn(f"failed: {title}: {why}")
    if len(failed):
        raise SystemExit(1)


def document_of(done: Any) -> Any:
    """The unrounded numbers of a verb's result, ready for JSON."""
    from egolane_pgm.tools.files import to_jsonable

    if hasattr(done, "document"):
        return done.document
    if hasattr(done, "scores"):
        return {"run": done.run, "scores": done.scores}
    if hasattr(done, "to_dict"):
        rows = done.reset_index().astype(object)
        return to_jsonable({"rows": rows.where(rows.notna(), None).to_dict("records")})
    return done


def warn(text: str) -> None:
    """Print a warning, a note or a failure on standard error."""
    from egolane_pgm.types import NOTE, in_one_line

    is_marked = text.startswith((NOTE, "failed: "))
    click.echo(in_one_line(text if is_marked else f"warning: {text}"), err=True)


# --- the group ---------------------------------------------------------------------------------


class _Group(click.Group):
    """Makes commands on demand; prints a user's mistake as one line, with exit code 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        return command_of(name) if name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:9}", help) for name, help in commands.items()])

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        from egolane_pgm.types import suggestion

        if args[0] not in COMMANDS and not args[0].startswith("-"):
            ctx.fail(f"No command '{args[0]}'{suggestion(args[0], COMMANDS)}.")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        # This imports NumPy, which `egolane --help` does not need.
        from egolane_pgm.types import InputError, in_one_line

        try:
            with warnings.catch_warnings():
                warnings.showwarning = lambda message, *_, **__: warn(str(message))
                return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            # A verb may name what was kept: KeyboardInterrupt("the lines are in x.csv").
            kept = str(stop) or "finished runs and trials are kept; repeat the command to go on"
            click.echo(f"egolane: interrupted; {kept}", err=True)
            ctx.exit(130)
        except InputError as error:
            click.echo(f"egolane: {error}", err=True)
            ctx.exit(2)
        except OSError as error:
            # Such as a name that is too long; a closed pipe has no name.
            if error.filename is None:
                raise
            click.echo(in_one_line(f"egolane: {error.filename}: {error.strerror}"), err=True)
            ctx.exit(2)
        except click.UsageError as error:
            if isinstance(error, click.exceptions.NoArgsIsHelpError):
                raise
            where = error.ctx.command_path if error.ctx else "egolane"
            text = in_one_line(error.format_message())
            click.echo(f"egolane: {text} See `{where} --help`.", err=True)
            ctx.exit(2)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def egolane() -> None:
    """Which lane is the car in? Noisy lane-line detections in, a belief over lanes out."""
