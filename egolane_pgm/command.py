"""The command `egolane`, made from the functions in `egolane_pgm.verbs`.

A verb's parameters before the `*` become arguments, the others options. Types give the checks, the
docstring gives the help, and `verbs.options.Option` the rest. A verb's module may also define:

- `text(done, style, wide)`: the output; without it `done.to_text()`.
- `summary(done, given)`: the last lines of the output, such as the path of a result.
- `failed(done)`: what failed, and why; the exit code is then 1.
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
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from egolane_pgm import __version__

if TYPE_CHECKING:
    from egolane_pgm.verbs.options import Option

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

#: Commands that print wide tables (`--format`, `--wide`), and those with `--json`.
WITH_TABLES = ("run", "compare", "reproduce")
WITH_JSON = (*WITH_TABLES, "show")

#: The first word of a message, which may be the name of a parameter.
_LEADING = re.compile(r"^\w+(?=:)")


def main() -> None:
    """Run the command `egolane`."""
    egolane(prog_name="egolane")


# --- a command from a verb ---------------------------------------------------------------------


def command_of(name: str) -> click.Command:
    """Make the command of a verb."""
    module = import_module(f"egolane_pgm.verbs.{name}")
    verb = getattr(module, name)
    if isinstance(verb, Mapping):
        parts = {each: _made(part, each, types.ModuleType(each)) for each, part in verb.items()}
        made: click.Command = click.Group(name, parts, help=module.__doc__)
    else:
        made = _made(verb, name, module)
    examples = "\n".join(f"  {example}" for example in module.EXAMPLES)
    made.epilog = f"\b\nExamples:\n{examples}"
    return made


def _made(verb: Callable[..., Any], name: str, module: types.ModuleType) -> click.Command:
    from egolane_pgm.types import InputError

    hints = typing.get_type_hints(verb, include_extras=True)
    text, helps = _docstring(inspect.getdoc(verb) or "")
    params: list[click.Parameter] = []
    for parameter in inspect.signature(verb).parameters.values():
        params += _params(parameter, hints[parameter.name], helps.get(parameter.name, ""))
    params += _common_options(name)
    names = {param.name: max(param.opts, key=len) for param in params}

    def callback(**values: Any) -> None:
        try:
            given = {key: _given(hints.get(key), key, v) for key, v in values.items()}
            _invoke(verb, given, module)
        except InputError as error:
            # A parameter of the Python function is an option here.
            text = _LEADING.sub(lambda m: names.get(m[0], m[0]), str(error))
            raise InputError(text) from error

    return click.Command(name, callback=callback, params=params, help=text)


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
        return kinds, [*hint.__metadata__, *extras]
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        parts = [_parts_of(part) for part in hint.__args__ if part is not types.NoneType]
        return [k for kinds, _ in parts for k in kinds], [e for _, extras in parts for e in extras]
    return [hint], []


def _option_of(extras: Sequence[Any]) -> Option:
    from egolane_pgm.verbs.options import Option

    return next((extra for extra in extras if isinstance(extra, Option)), Option())


def _params(parameter: inspect.Parameter, hint: Any, help: str) -> list[click.Parameter]:
    """The argument or option of a verb's parameter; none if it is hidden."""
    name, default, (kinds, extras) = parameter.name, parameter.default, _parts_of(hint)
    option = _option_of(extras)
    if option.hidden:
        return []
    given = None if default in (inspect.Parameter.empty, ()) else default
    settings: dict[str, Any] = {"metavar": option.metavar, "type": _type_of(kinds, extras)}
    settings["required"] = option.required or default is inspect.Parameter.empty
    if parameter.kind is not inspect.Parameter.KEYWORD_ONLY:
        settings |= {} if given is None else {"default": given}
        return [click.Argument([name], nargs=-1 if option.many else 1, **settings)]
    value = given if option.default is None else option.default
    help = f"Do not {help}" if default is True else help[:1].upper() + help[1:]
    if option.shown or not (value is None or isinstance(value, bool)):
        help += f"  [default: {option.shown or value}]"
    long = f"--{name.rstrip('_').replace('_', '-')}"
    if bool in kinds:
        names = option.names or (f"--no-{name}" if default is True else long,)
        flag = {"is_flag": True, "default": default, "flag_value": default is not True}
        return [click.Option([*names, name], help=help, **flag)]
    names = option.names if any(n.startswith("--") for n in option.names) else (*option.names, long)
    settings |= {"multiple": option.many or _is_mapping(kinds), "envvar": option.envvar}
    settings |= {} if value is None else {"default": value}
    return [click.Option([*names, name], help=help, **settings)]


def _is_mapping(kinds: Sequence[Any]) -> bool:
    """Whether a parameter takes only names and values."""
    return [typing.get_origin(each) for each in kinds] == [Mapping]


def _type_of(kinds: Sequence[Any], extras: Sequence[Any]) -> Any:
    """The type by which click checks a value."""
    first = kinds[0]
    if typing.get_origin(first) is typing.Literal:
        return click.Choice([*first.__args__])
    if typing.get_origin(first) is tuple:
        return first.__args__
    if first in (int, float):
        low, high = (
            next((getattr(extra, key) for extra in extras if hasattr(extra, key)), None)
            for key in ("ge", "le")
        )
        if low is None and high is None:
            return first
        return (click.IntRange if first is int else click.FloatRange)(low, high)
    is_path = any(typing.get_origin(each) is os.PathLike for each in kinds)
    return click.Path() if is_path else str


def _common_options(name: str) -> list[click.Parameter]:
    """The options of commands that print tables and numbers."""
    style = click.Choice(["markdown", "latex", "csv"])
    wide = "Print all columns; without it those that do not fit the terminal are left out."
    if name == "run":
        wide = "Print all scores, confusion matrices and lane changes, in tables of any width."
    as_json = "Write the unrounded numbers as JSON; - prints them only."
    tables: list[click.Parameter] = [
        click.Option(
            ["--format", "table_style"],
            type=style,
            default="markdown",
            show_default=True,
            help="Format of tables; csv is unrounded.",
        ),
        click.Option(["--wide"], is_flag=True, help=wide),
    ]
    to_file = click.Option(["--json", "json_file"], type=click.Path(), metavar="FILE", help=as_json)
    return tables * (name in WITH_TABLES) + [to_file] * (name in WITH_JSON)


# --- what a command does -----------------------------------------------------------------------


def _invoke(verb: Callable[..., Any], values: dict[str, Any], module: types.ModuleType) -> None:
    """Call a verb with the values of the command line, and print what it returns."""
    from egolane_pgm.tools.files import check_not_read, check_place, json_text, write_json
    from egolane_pgm.verbs.options import several_of

    style, wide = values.pop("table_style", "markdown"), values.pop("wide", False)
    json_file = values.pop("json_file", None)
    given = {name: value for name, value in values.items() if value != ()}
    prints = io.StringIO() if json_file == "-" else sys.stdout
    if json_file not in (None, "-"):
        each_given = (v for value in given.values() for v in several_of(value))
        check_not_read(Path(json_file), [Path(v) for v in each_given if isinstance(v, str) and v])
        check_place(Path(json_file))
    text, summary = getattr(module, "text", None), getattr(module, "summary", None)
    with contextlib.redirect_stdout(prints):
        done = verb(**given)
        # The file is written before anything is printed: a reader may close the pipe.
        if json_file not in (None, "-"):
            write_json(Path(json_file), document_of(done))
        for note in getattr(done, "notes", ()):
            warn(note)
        if text is not None:
            printed = text(done, style, wide)
        else:
            printed = done.to_text() if hasattr(done, "to_text") else done
        if isinstance(printed, str) and printed:
            click.echo(printed)
        end = summary(done, given) if summary is not None and done is not None else ""
        if end:
            click.echo(f"\n{end}" if isinstance(printed, str) else end, err=style != "markdown")
    if json_file == "-":
        click.echo(json_text(document_of(done)), nl=False)
    failed: list[tuple[str, str]] = getattr(module, "failed", lambda done: [])(done)
    for title, why in failed:
        warn(f"failed: {title}: {why}")
    if failed:
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


def _given(hint: Any, name: str, value: Any) -> Any:
    """Convert a value of the command line to what the verb takes."""
    from egolane_pgm.loading import read_override
    from egolane_pgm.types import InputError

    kinds, extras = _parts_of(hint)
    option = _option_of(extras)
    if value == "" or (isinstance(value, tuple) and "" in value):
        raise InputError(f"{name}: is empty")
    if _is_mapping(kinds):
        return dict(read_override(each, option.example or "name=value", name) for each in value)
    return value


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
