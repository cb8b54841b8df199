"""The commands `egolane ls` and `egolane validate`."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm.cli import options
from egolane_pgm.experiment import load_experiment, load_yaml
from egolane_pgm.loading import check_sources
from egolane_pgm.model import prepare_model
from egolane_pgm.paper import experiments_folder
from egolane_pgm.plugins import plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.simulation import PRESETS
from egolane_pgm.tuning.plan import check_plan, load_plan


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
        is_part = path.name.startswith("_")
        if path.name != "published.yaml" and path.parent.name != "tuning" and not is_part:
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
