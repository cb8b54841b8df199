"""The command `egolane`: finds a command's file, and turns what goes wrong into one line."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import click
from click.shell_completion import CompletionItem

from egolane_pgm import __version__
from egolane_pgm.cli.examples import EXAMPLES

#: The file of each command, which has a function of the command's name, and its short help. A
#: command's file is imported only when that command is asked for: `--help` stays quick, and each
#: file may import at its top what it needs.
COMMANDS = {
    "calibrate": ("calibrate", "Find out how a camera sees the road."),
    "compare": ("compare", "Compare experiments on frames that their parameters have not seen."),
    "convert": ("recordings", "Convert a recording of lines to .bag, .csv or .parquet."),
    "data": ("recordings", "List, download and check the paper's recordings."),
    "detect": ("detect", "Detect and follow lines in pictures of a camera."),
    "export": ("export", "Write a result for a viewer: Foxglove, PlotJuggler, rerun."),
    "label": ("label", "Label a recording's lanes, and list what a human should look at."),
    "learn": ("learn", "Learn an experiment from its recording."),
    "lines": ("recordings", "Print the lines of one frame as in the paper's Box 1."),
    "locate": ("locate", "Find the road of a car on a map, and what is ahead of it."),
    "ls": ("show", "List graphs, evidence rules, detectors and experiments."),
    "map": ("map", "Read the lanes of motorways from an extract of OpenStreetMap."),
    "network": ("network", "Write a graph: a picture, or text for other programs."),
    "online": ("online", "Filter frame by frame: a JSON line in, its belief out at once."),
    "plot": ("plot", "Draw the figures of result directories and studies."),
    "reproduce": ("paper", "Repeat the paper's ten runs, beside the published tables."),
    "report": ("report", "Show results as one interactive HTML page."),
    "run": ("run", "Filter a recording, score it, write a result directory."),
    "schema": ("schema", "Print the JSON Schema of experiments, for editors."),
    "show": ("show", "Show a graph, an evidence rule or a detector, and its parameters."),
    "simulate": ("simulate", "Simulate a drive, as lines or as pictures."),
    "tune": ("tune", "Search parameters, and score them on frames they have not seen."),
    "validate": ("show", "Check experiments and tuning files without computing anything."),
    "video": ("video", "Draw a drive: pictures, lines, bird's-eye view and belief."),
}


class _Group(click.Group):
    """Imports a command when it is asked for, and turns what a user can mend into one line and
    exit code 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command = getattr(import_module(f"egolane_pgm.cli.{COMMANDS[name][0]}"), name)
        assert isinstance(command, click.Command)
        lines = (f"  {example}" for example in EXAMPLES[name])
        command.epilog = "\n".join(["\b", "Examples:", *lines])
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        # Click would import each command to ask it for its help.
        names = [name for name in COMMANDS if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [CompletionItem(name, help=COMMANDS[name][1]) for name in names] + options

    def invoke(self, ctx: click.Context) -> Any:
        # This imports NumPy, which `egolane --help` does not need.
        from egolane_pgm.types import InputError, in_one_line

        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            # A command that knows what was kept says so: KeyboardInterrupt("3 of 5 are in x;
            # the same command begins anew").
            kept = str(stop) or "nothing was left half-written; the same command begins anew"
            click.echo(f"egolane: interrupted; {kept}", err=True)
            ctx.exit(130)
        except InputError as error:
            for line in error.lines:
                click.echo(f"egolane: {line}", err=True)
            ctx.exit(2)
        except click.UsageError as error:
            if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):
                raise
            where = error.ctx.command_path if error.ctx else "egolane"
            said = in_one_line(error.format_message())
            click.echo(f"egolane: {said} See `{where} --help`.", err=True)
            ctx.exit(2)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    from egolane_pgm.cli.options import warn

    warn(str(message))


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def egolane() -> None:
    """Which lane is the car in? Noisy lane-line detections in, a belief over lanes out."""
