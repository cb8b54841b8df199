"""The command `egolane`: parses, calls, prints. Everything heavy is imported inside a command."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import click

from egolane_pgm import __version__
from egolane_pgm.cli import calibrate as _cli_camera
from egolane_pgm.cli import compare as _cli_compare
from egolane_pgm.cli import detect as _cli_detect
from egolane_pgm.cli import learn as _cli_learn
from egolane_pgm.cli import recordings as _cli_recordings
from egolane_pgm.cli import run as _cli_run
from egolane_pgm.cli import studies as _cli_studies
from egolane_pgm.cli import tune as _cli_tune
from egolane_pgm.cli import video as _cli_video


class _Group(click.Group):
    """Turns what a user can mend into one line and exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        # numpy is imported by the types, so only once a command is really run.
        from egolane_pgm.types import InputError

        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except InputError as error:
            click.echo(f"egolane: {_safe(' '.join(str(error).split()))}", err=True)
            ctx.exit(2)
        except click.UsageError as error:
            if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):
                raise
            where = error.ctx.command_path if error.ctx else "egolane"
            said = _safe(error.format_message())
            click.echo(f"egolane: {said} See `{where} --help`.", err=True)
            ctx.exit(2)
        except KeyboardInterrupt:
            click.echo("egolane: interrupted; nothing was left half-written", err=True)
            ctx.exit(130)
        except BrokenPipeError:
            # Whoever read our output has had enough; say nothing at exit either.
            _give_up_output()
            ctx.exit(1)
        except OSError as error:
            # Printing on a full disk, mostly: files of ours are spoken of where they are written.
            where = error.filename or "output"
            _give_up_output()
            click.echo(f"egolane: {where}: {error.strerror or error}", err=True)
            ctx.exit(2)
        except UnicodeEncodeError as error:
            name = str(error.object)[:200]
            click.echo(f"egolane: {name!a}: is not text in UTF-8; rename the file", err=True)
            ctx.exit(2)


def _give_up_output() -> None:
    """What is still to be printed goes nowhere, so that nothing is said of it at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _safe(text: str) -> str:
    """A message without the password of an address that was given in the wrong place."""
    if ":/" not in text:
        return text
    from egolane_pgm.tune.address import without_passwords

    return without_passwords(text)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"warning: {message}", err=True)


def main() -> None:
    """The console script."""
    egolane(prog_name="egolane")


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def egolane() -> None:
    """Which lane is the car in? Noisy lane-line detections in, a belief over lanes out."""


_experiment = click.argument("experiment", type=click.Path(dir_okay=False))
_set = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a key of the YAML, e.g. parameters.bonus_value=0.",
)
_json = click.option(
    "--json",
    "json_file",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write the unrounded numbers as JSON.",
)
_numpy = click.option(
    "--numpy", "use_numpy", is_flag=True, help="Use the plain NumPy twins of the kernels."
)


@egolane.command("ls")
def list_experiments() -> None:
    """List graphs, evidence rules, detectors, simulated drives and experiments that come along."""
    from egolane_pgm.paper import experiments_folder
    from egolane_pgm.plugins import plugin_names
    from egolane_pgm.recordings import FORMATS
    from egolane_pgm.simulation import PRESETS

    click.echo(f"graphs:      {', '.join(plugin_names('graphs'))}")
    click.echo(f"evidence:    {', '.join(plugin_names('evidence'))}")
    click.echo(f"detectors:   {', '.join(plugin_names('detectors'))}")
    click.echo(f"recordings:  {', '.join(FORMATS)}")
    click.echo(f"simulations: {', '.join(sorted(PRESETS))}")
    click.echo("experiments:")
    from egolane_pgm.experiment import load_experiment, load_yaml

    tuning = experiments_folder() / "tuning"
    for path in sorted(experiments_folder().rglob("*.yaml")):
        if path.name != "published.yaml" and path.parent.name != "tuning":
            found = load_experiment(path)
            click.echo(f"  {_shown(path)}  {found.description}")
    click.echo("tuning files (for `egolane tune`):")
    for path in sorted(tuning.glob("*.yaml")):
        click.echo(f"  {_shown(path)}  {load_yaml(path).get('description', '')}")


@egolane.command()
@click.argument("experiments", nargs=-1, required=True, type=click.Path(dir_okay=False))
@_set
def validate(experiments: tuple[str, ...], overrides: tuple[str, ...]) -> None:
    """Check experiments, and tuning files with theirs, without computing anything: keys, plugins,
    parameters, files."""
    from egolane_pgm.experiment import load_experiment, load_yaml
    from egolane_pgm.loading import check_sources
    from egolane_pgm.model import prepare_model
    from egolane_pgm.tune.plan import check_plan, load_plan

    for path in experiments:
        if "experiments" in load_yaml(Path(path), overrides):
            plan = load_plan(path, overrides)
            n_searched = check_plan(plan)
            for each in plan.experiments:
                check_sources(each)
            click.echo(
                f"{path}: ok ({len(plan.experiments)} experiment(s), {n_searched} numbers searched)"
            )
            continue
        experiment = load_experiment(path, overrides)
        model = prepare_model(experiment)
        check_sources(experiment)
        states = model.compiled.n_states
        click.echo(f"{path}: ok ({experiment.n_lanes} lanes, {states} joint states)")


@egolane.command()
@click.option("--runs", default="1-10", show_default=True, help="E.g. 1-5,7.")
@click.option(
    "--parameters",
    "which",
    type=click.Choice(["recovered", "published"]),
    default="recovered",
    show_default=True,
    help="Recovered (by a search; run 5 from the authors' code), or as printed (truncated).",
)
@click.option(
    "--format",
    "style",
    type=click.Choice(["markdown", "latex", "csv"]),
    default="markdown",
    show_default=True,
)
@click.option("--matrices", is_flag=True, help="Print every confusion matrix too.")
@click.option(
    "--if-available",
    is_flag=True,
    help="Without the recordings: offer the download, or say how to get them, and end well.",
)
@click.option("--out", type=click.Path(file_okay=False), help="Keep a result directory per run.")
@_numpy
@_json
def reproduce(
    runs: str,
    which: str,
    style: str,
    matrices: bool,
    if_available: bool,
    out: str | None,
    use_numpy: bool,
    json_file: str | None,
) -> None:
    """The paper's ten runs: ours beside the 20 published tables, and the difference."""
    from tqdm import tqdm

    from egolane_pgm import paper as paper
    from egolane_pgm.report import tables
    from egolane_pgm.results import check_place, write_json
    from egolane_pgm.run import save_run

    numbers = paper.parse_runs(runs)
    if json_file:
        check_place(Path(json_file))
    if if_available and not _cli_recordings.have_recordings():
        return
    done = []
    for number in tqdm(numbers, desc="runs", unit="run", leave=False, disable=None):
        result = paper.reproduce_run(number, which, kernel=not use_numpy)
        done.append(result)
        if out:
            save_run(result.run, Path(out) / result.run.experiment.name)
    document = paper.reproduce_json(done, which)
    header, rows = tables.reproduction_rows(document, paper.load_published())
    draw = {"markdown": tables.markdown, "latex": tables.latex, "csv": tables.as_csv}[style]
    click.echo(draw(header, rows))
    if matrices:
        for entry in document["runs"]:
            for kind in ("detector", "model"):
                title = f"run {entry['run']}, {kind}"
                click.echo("\n" + tables.confusion_table(entry[kind]["confusion"], title))
    if style == "markdown":
        frames = sum(2 * entry["frames_scored"] for entry in document["runs"])
        click.echo(
            f"\n{document['total_frames_off']} of {frames} classified frames differ from the"
            f" published matrices (parameters: {which}; in-sample, as in the paper)"
        )
    if json_file:
        write_json(Path(json_file), document)


@egolane.command()
@click.option("--run", "number", type=int, required=True, help="Which of the paper's runs.")
@click.option("--evaluations", type=click.IntRange(1), default=20_000, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--write", is_flag=True, help="Keep the set in published.yaml under `recovered`.")
@_json
def recover(number: int, evaluations: int, seed: int, write: bool, json_file: str | None) -> None:
    """Search the published, truncated parameters' box for the values that were really used."""
    from tqdm import tqdm

    from egolane_pgm import paper as paper
    from egolane_pgm.results import SCHEMA_VERSION, check_place, write_json

    paper.paper_experiment(number)
    if json_file:
        check_place(Path(json_file))
    with tqdm(total=evaluations, desc=f"run {number}", leave=False, disable=None) as bar:

        def progress(done: int, off: int) -> None:
            bar.update(done - bar.n)
            bar.set_postfix(frames_off=off)

        found = paper.recover(number, evaluations=evaluations, seed=seed, progress=progress)
    values = ", ".join(f"{k}: {v!r}" for k, v in found.parameters.items())
    click.echo(f"run {number}: {found.frames_off} frames off after {found.evaluations} evaluations")
    click.echo(f"{{{values}}}")
    if write:
        how = f"random search in the box of the truncated values, seed {seed}"
        paper.store_recovered(number, found, how)
        click.echo(f"written to {_shown(paper.published_path())}")
    if json_file:
        write_json(
            Path(json_file),
            {
                "schema_version": SCHEMA_VERSION,
                "run": number,
                "frames_off": found.frames_off,
                "evaluations": found.evaluations,
                "seed": seed,
                "parameters": dict(found.parameters),
            },
        )


def _shown(path: Path) -> str:
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


@egolane.command()
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
    from egolane_pgm.report.draw import draw_standard, draw_together
    from egolane_pgm.report.study_figures import draw_study
    from egolane_pgm.report.study_trials import is_study
    from egolane_pgm.types import InputError

    drives = [Path(path) for path in results if not is_study(path)]
    if frames and len(drives) < len(results):
        raise InputError("--frames: goes with results; the figures of a study have no frames")
    for path in results:
        folder = Path(path)
        target = Path(out) / folder.name if out and len(results) > 1 else Path(out or "")
        target = target if out else folder / "figures"
        if folder in drives:
            files = draw_standard(folder, target, frames=frames, style=style)
        else:
            files = draw_study(folder, target, style=style)
        for file in files:
            click.echo(file)
    if len(drives) > 1:
        target = Path(out) if out else drives[0].parent
        for file in draw_together(drives, target, style=style):
            click.echo(file)


@egolane.command()
@click.argument("graph")
@click.argument("target", type=click.Path(dir_okay=False))
@click.option("--n-lanes", type=click.IntRange(1), default=3, show_default=True)
def network(graph: str, target: str, n_lanes: int) -> None:
    """Draw a graph (a name, or a file of your own) as a figure, two slices."""
    from egolane_pgm.parameters import resolve_parameters
    from egolane_pgm.plugins import load_plugin, plugin_errors
    from egolane_pgm.report.network import draw_network
    from egolane_pgm.types import MAX_LANES, InputError

    if n_lanes > MAX_LANES:
        raise InputError(f"--n-lanes: {n_lanes} is more than {MAX_LANES}")
    module = load_plugin("graphs", graph, Path.cwd(), "graph")
    parameters = resolve_parameters(getattr(module, "PARAMETERS", ()), {}, n_lanes)
    with plugin_errors(module, "graph"):
        built = module.build(n_lanes, parameters)
    draw_network(built, Path(target))
    click.echo(target)


for _command in (
    _cli_camera.calibrate,
    _cli_compare.compare,
    _cli_detect.detect,
    _cli_learn.learn,
    _cli_recordings.data,
    _cli_recordings.convert,
    _cli_recordings.simulate,
    _cli_recordings.online,
    _cli_run.run,
    _cli_studies.studies,
    _cli_tune.tune,
    _cli_video.lines,
    _cli_video.video,
):
    egolane.add_command(_command)
