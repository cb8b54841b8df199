"""The commands of `egolane` that look and do not compute: ls, validate, plot and network."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.experiment import load_experiment, load_yaml
from egolane_pgm.loading import check_sources
from egolane_pgm.model import prepare_model
from egolane_pgm.paper import experiments_folder
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_errors, plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.report.draw import draw_standard, draw_together
from egolane_pgm.report.network import draw_network
from egolane_pgm.report.study_figures import draw_study
from egolane_pgm.report.study_trials import is_study
from egolane_pgm.simulation import PRESETS
from egolane_pgm.tune.plan import check_plan, load_plan
from egolane_pgm.types import MAX_LANES, InputError


@click.command()
def ls() -> None:
    """List graphs, evidence rules, detectors, simulated drives and experiments that come along."""
    click.echo(f"graphs:      {', '.join(plugin_names('graphs'))}")
    click.echo(f"evidence:    {', '.join(plugin_names('evidence'))}")
    click.echo(f"detectors:   {', '.join(plugin_names('detectors'))}")
    click.echo(f"recordings:  {', '.join(FORMATS)}")
    click.echo(f"simulations: {', '.join(sorted(PRESETS))}")
    click.echo("experiments:")
    tuning = experiments_folder() / "tuning"
    for path in sorted(experiments_folder().rglob("*.yaml")):
        if path.name != "published.yaml" and path.parent.name != "tuning":
            found = load_experiment(path)
            click.echo(f"  {options.shown(path)}  {found.description}")
    click.echo("tuning files (for `egolane tune`):")
    for path in sorted(tuning.glob("*.yaml")):
        click.echo(f"  {options.shown(path)}  {load_yaml(path).get('description', '')}")


@click.command()
@click.argument("experiments", nargs=-1, required=True, type=click.Path(dir_okay=False))
@options.overrides()
def validate(experiments: tuple[str, ...], overrides: tuple[str, ...]) -> None:
    """Check experiments, and tuning files with theirs, without computing anything: keys, plugins,
    parameters, files."""
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
            files = draw_standard(folder, target, frames=frames, style=style)
        else:
            files = draw_study(folder, target, style=style)
        for file in files:
            click.echo(file)
    if len(drives) > 1:
        target = Path(out) if out else drives[0].parent
        for file in draw_together(drives, target, style=style):
            click.echo(file)


@click.command()
@click.argument("graph")
@click.argument("target", type=click.Path(dir_okay=False))
@click.option("--n-lanes", type=click.IntRange(1), default=3, show_default=True)
def network(graph: str, target: str, n_lanes: int) -> None:
    """Draw a graph (a name, or a file of your own) as a figure, two slices."""
    if n_lanes > MAX_LANES:
        raise InputError(f"--n-lanes: {n_lanes} is more than {MAX_LANES}")
    module = load_plugin("graphs", graph, Path.cwd(), "graph")
    parameters = resolve_parameters(getattr(module, "PARAMETERS", ()), {}, n_lanes)
    with plugin_errors(module, "graph"):
        built = module.build(n_lanes, parameters)
    draw_network(built, Path(target))
    click.echo(target)
