"""The command `egolane`, made from the verbs: a command's arguments, options and help are those of
its function's signature and docstring.

Parameters before the `*` become arguments, the others options; types give their checks, and
`verbs.given.Option` describes what name and type do not. A verb whose result has `to_text`, or
whose module has `text`, gets `--format` and `--wide`; one whose result is a Result, a DataFrame,
a dict or has a `document` gets `--json`.
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
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from egolane_pgm import __version__

if TYPE_CHECKING:
    from egolane_pgm.verbs.given import Option

#: The short help of each command, whose verb is the function of its name in verbs/. A verb is
#: imported only when its command is asked for: `--help` stays quick.
COMMANDS = {
    "calibrate": "Find out how a camera sees the road.",
    "compare": "Compare results, with paired intervals.",
    "data": "List, download and check the paper's recordings.",
    "detect": "Detect and follow lines in pictures of a camera.",
    "label": "Label a recording's lanes, and list what a human should look at.",
    "learn": "Fit a model to its recording; score it on held-out frames.",
    "locate": "Find the road of a car on a map.",
    "online": "Filter frame by frame: a JSON line in, its belief out at once.",
    "plot": "Draw results and studies: figures, a page, a video, an MCAP file.",
    "reproduce": "Repeat the paper's ten runs, beside the published tables.",
    "run": "Infer the lane in a recording, score it, write a result directory.",
    "show": "List what there is, or describe it: graphs, rules, detectors, experiments.",
    "simulate": "Simulate a drive, as lines or as pictures.",
    "tune": "Search parameters, and score them on frames they have not seen.",
}

#: The first word of a message, which may be a parameter's name.
_LEADING = re.compile(r"^\w+(?=:)")


def main() -> None:
    """Run the command `egolane`."""
    egolane(prog_name="egolane")


# --- a command from a verb ---------------------------------------------------------------------


def command_of(name: str) -> click.Command:
    """The command that is made from the verb of a name."""
    own = name.replace("-", "_")
    module = import_module(f"egolane_pgm.verbs.{own}")
    verb = getattr(module, own)
    if isinstance(verb, Mapping):
        parts = {each: _made(part, each, types.ModuleType(each)) for each, part in verb.items()}
        made: click.Command = click.Group(name, parts, help=module.__doc__)
    else:
        made = _made(verb, name, module)
    examples = "\n".join(f"  {example}" for example in getattr(module, "EXAMPLES", ()))
    made.epilog = f"\b\nExamples:\n{examples}" if examples else None
    return made


def _made(verb: Callable[..., Any], name: str, module: types.ModuleType) -> click.Command:
    from egolane_pgm.types import InputError

    hints = typing.get_type_hints(verb, include_extras=True)
    text, said = _docstring(inspect.getdoc(verb) or "")
    params: list[click.Parameter] = []
    for parameter in inspect.signature(verb).parameters.values():
        params += _params(parameter, hints[parameter.name], said.get(parameter.name, ""))
    results, _ = _parts_of(hints["return"])
    if hasattr(module, "text") or any(hasattr(result, "to_text") for result in results):
        params += _tables()
    if any(_has_document(result) for result in results):
        help = "Write the unrounded numbers as JSON; - prints them, and nothing else."
        params.append(
            click.Option(["--json", "json_file"], type=click.Path(), metavar="FILE", help=help)
        )

    names = {param.name: max(param.opts, key=len) for param in params}

    def callback(**values: Any) -> None:
        try:
            given = {key: _given(hints.get(key), key, v) for key, v in values.items()}
            _invoke(verb, given, module)
        except InputError as error:
            # What a Python caller knows as a parameter is an option here.
            said = _LEADING.sub(lambda m: names.get(m[0], m[0]), str(error))
            raise InputError(said) from error

    return click.Command(name, callback=callback, params=params, help=text)


def _has_document(result: Any) -> bool:
    """Whether a verb's result, of some type, can be written as JSON."""
    names = (*dir(result), *getattr(result, "__annotations__", ()))
    return typing.get_origin(result) is dict or not {"document", "scores", "to_dict"}.isdisjoint(
        names
    )


def document_of(done: Any) -> Any:
    """The unrounded numbers of a verb's result, ready for JSON."""
    from egolane_pgm.tools.files import plain

    if hasattr(done, "document"):
        return done.document
    if hasattr(done, "scores"):
        return {"run": done.run, "scores": done.scores}
    if hasattr(done, "to_dict"):
        rows = done.reset_index().astype(object)
        return plain({"rows": rows.where(rows.notna(), None).to_dict("records")})
    return done


def _docstring(text: str) -> tuple[str, dict[str, str]]:
    """What a docstring says of the verb, without what is for Python callers only (what it returns
    and raises, and its examples), and of each parameter."""
    about: list[str] = []
    said: dict[str, str] = {}
    for paragraph in text.split("\n\n"):
        if paragraph.startswith((">>>", "Returns ", "Raises ")):
            continue
        if not paragraph.startswith("- "):
            about.append(paragraph)
            continue
        for item in re.split(r"\n(?=- )", paragraph):
            names, _, meaning = item.removeprefix("- ").partition(":")
            for each in names.split(","):
                said[each.strip()] = " ".join(meaning.split())
    return "\n\n".join(about), said


def _parts_of(hint: Any) -> tuple[list[Any], list[Any]]:
    """The types of a hint, of a union each without None, and what they are annotated with, the
    outermost first."""
    if typing.get_origin(hint) is typing.Annotated:
        kinds, extras = _parts_of(hint.__origin__)
        return kinds, [*hint.__metadata__, *extras]
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        parts = [_parts_of(part) for part in hint.__args__ if part is not types.NoneType]
        return [k for kinds, _ in parts for k in kinds], [e for _, extras in parts for e in extras]
    return [hint], []


def _looks(extras: Sequence[Any]) -> Option:
    from egolane_pgm.verbs.given import Option

    return next((extra for extra in extras if isinstance(extra, Option)), Option())


def _params(parameter: inspect.Parameter, hint: Any, said: str) -> list[click.Parameter]:
    """The argument or the options of a verb's parameter.

    - said: what the docstring says of it.
    """
    name, default, (kinds, extras) = parameter.name, parameter.default, _parts_of(hint)
    looks = _looks(extras)
    if looks.hidden:
        return []
    given = None if default in (inspect.Parameter.empty, ()) else default
    settings: dict[str, Any] = {"metavar": looks.metavar, "type": _type_of(kinds, extras)}
    required = looks.required or default is inspect.Parameter.empty
    if parameter.kind is not inspect.Parameter.KEYWORD_ONLY:
        nargs = -1 if looks.many else 1
        # To click a default of None is a value: nothing would be missing.
        settings |= {} if given is None else {"default": given}
        return [click.Argument([name], nargs=nargs, required=required, **settings)]
    value = given if looks.default is None else looks.default
    help = f"Do not {said}" if default is True else said[:1].upper() + said[1:]
    if looks.said or not (value is None or isinstance(value, bool)):
        help += f"  [default: {looks.said or value}]"
    if bool in kinds:
        no = "no-" if default is True else ""
        names = looks.names or (f"--{no}{_dashed(name)}",)
        flag = default is not True
        return [
            click.Option([*names, name], is_flag=True, default=default, flag_value=flag, help=help)
        ]
    if name == "overrides":
        settings |= {"metavar": "KEY=VALUE", "multiple": True}
        looks = replace(looks, names=("--set",))
    long = () if any(each.startswith("--") for each in looks.names) else (f"--{_dashed(name)}",)
    settings |= {"required": required, "envvar": looks.envvar}
    settings |= {} if value is None else {"default": value}
    if looks.many or _is_mapping(kinds):
        settings["multiple"] = True
    made = click.Option([*looks.names, *long, name], help=help, **settings)
    return [made]


def _dashed(name: str) -> str:
    return name.rstrip("_").replace("_", "-")


def _is_mapping(kinds: Sequence[Any]) -> bool:
    """Whether a parameter takes names and values, and nothing else."""
    return [typing.get_origin(each) for each in kinds] == [Mapping]


def _type_of(kinds: Sequence[Any], extras: Sequence[Any]) -> Any:
    """The type that click checks a value by."""
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


def _tables() -> list[click.Parameter]:
    """The options of a command that prints tables."""
    style = click.Choice(["markdown", "latex", "csv"])
    of_style = "Of the tables; csv is the first one alone, one number in a cell."
    of_wide = "Whole tables, for a file, not only what fits the terminal (or COLUMNS, or 80)."
    return [
        click.Option(
            ["--format", "table_style"],
            type=style,
            default="markdown",
            show_default=True,
            help=of_style,
        ),
        click.Option(["--wide"], is_flag=True, help=of_wide),
    ]


# --- what a command does -----------------------------------------------------------------------


def _invoke(verb: Callable[..., Any], values: dict[str, Any], module: types.ModuleType) -> None:
    """Call a verb with what the command line gave, and print what it returns.

    - values: by the names of the parameters; also `table_style`, `wide` and `json_file`.
    - module: of the verb; its `text` and `says` make the output.
    """
    from egolane_pgm.tools.files import check_not_read, check_place, json_text, write_json
    from egolane_pgm.verbs.given import several_of

    style, wide = values.pop("table_style", "markdown"), values.pop("wide", False)
    json_file = values.pop("json_file", None)
    given = {name: value for name, value in values.items() if value != ()}
    prints = io.StringIO() if json_file == "-" else sys.stdout
    if json_file is not None and json_file != "-":
        each_given = (v for value in given.values() for v in several_of(value))
        paths = [Path(each) for each in each_given if isinstance(each, str) and each]
        check_not_read(Path(json_file), [file for path in paths for file in _files_of(path)])
        check_place(Path(json_file))
    texts, says = getattr(module, "text", None), getattr(module, "says", None)
    with contextlib.redirect_stdout(prints):
        done = verb(**given)
        # The file is written before anything is printed, because a reader may close the pipe.
        if json_file not in (None, "-"):
            write_json(Path(json_file), document_of(done))
        for note in getattr(done, "notes", ()):
            warn(note)
        printed = ""
        if texts is not None:
            printed = texts(done, style, wide)
        elif hasattr(done, "to_text"):
            printed = done.to_text(style=style, wide=wide)
        elif isinstance(done, str):
            printed = done
        if printed:
            click.echo(printed)
        said = says(done, given) if says is not None and done is not None else ""
        if said:
            click.echo(("\n" if printed else "") + said, err=style != "markdown")
    if json_file == "-":
        click.echo(json_text(document_of(done)), nl=False)
    failed: list[tuple[str, str]] = getattr(module, "failed", lambda done: [])(done)
    for title, why in failed:
        _say(f"failed: {title}: {why}")
    if failed:
        raise SystemExit(1)


def _files_of(path: Path) -> list[Path]:
    """A file, and of an experiment those that it names."""
    from egolane_pgm.drives import data_files
    from egolane_pgm.loading import load_experiment
    from egolane_pgm.types import InputError

    with contextlib.suppress(InputError):
        return [path, *data_files(load_experiment(path))]
    return [path]


def _given(hint: Any, name: str, value: Any) -> Any:
    """A value of the command line as the verb takes it: several that are one as that one."""
    from egolane_pgm.loading import read_override
    from egolane_pgm.types import InputError

    kinds, extras = _parts_of(hint)
    looks = _looks(extras)
    if value == "" or (isinstance(value, tuple) and "" in value):
        raise InputError(f"{name}: is empty")
    if _is_mapping(kinds):
        return dict(read_override(each, looks.example or "name=value", name) for each in value)
    return value[0] if looks.many and len(value) == 1 else value


def warn(text: str) -> None:
    """Print a warning, or a note, on standard error."""
    from egolane_pgm.types import NOTE

    _say(text if text.startswith(NOTE) else f"warning: {text}")


def _say(text: str) -> None:
    from egolane_pgm.types import in_one_line

    click.echo(in_one_line(text), err=True)


# --- the group ---------------------------------------------------------------------------------


class _Group(click.Group):
    """Makes a command when it is asked for, and turns what a user can mend into one line and exit
    code 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        return command_of(name) if name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([*COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        # Click would import each command to ask it for its help.
        names = [name for name in COMMANDS if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [CompletionItem(name, help=COMMANDS[name]) for name in names] + options

    def invoke(self, ctx: click.Context) -> Any:
        # This imports NumPy, which `egolane --help` does not need.
        from egolane_pgm.types import InputError, in_one_line

        try:
            with warnings.catch_warnings():
                warnings.showwarning = lambda message, *_, **__: warn(str(message))
                return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            # A verb that knows what was kept says so: KeyboardInterrupt("3 of 5 are in x; the same
            # command begins anew").
            kept = str(stop) or "nothing was left half-written; the same command begins anew"
            click.echo(f"egolane: interrupted; {kept}", err=True)
            ctx.exit(130)
        except InputError as error:
            click.echo(f"egolane: {error}", err=True)
            ctx.exit(2)
        except click.UsageError as error:
            if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):
                raise
            where = error.ctx.command_path if error.ctx else "egolane"
            said = in_one_line(error.format_message())
            click.echo(f"egolane: {said} See `{where} --help`.", err=True)
            ctx.exit(2)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def egolane() -> None:
    """Which lane is the car in? Noisy lane-line detections in, a belief over lanes out."""
