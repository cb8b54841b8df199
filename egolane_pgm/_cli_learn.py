"""The command `egolane learn`."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("experiment", type=click.Path(dir_okay=False))
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False),
    help="The new experiment; default learned_<name>.yaml here.",
)
@click.option("--blocks", type=click.IntRange(2), default=5, show_default=True)
@click.option(
    "--json", "json_file", type=click.Path(dir_okay=False), help="Write the scores as JSON."
)
def learn(
    experiment: str,
    overrides: tuple[str, ...],
    out: str | None,
    blocks: int,
    json_file: str | None,
) -> None:
    """Learn an experiment's parameters from its labelled frames: a new experiment, and what they
    are worth held out."""
    import yaml

    from egolane_pgm.experiment import load_experiment
    from egolane_pgm.learn import learn as run_learn
    from egolane_pgm.learn import learned_yaml
    from egolane_pgm.report.tables import scores_table
    from egolane_pgm.results import SCHEMA_VERSION, check_place, write_json
    from egolane_pgm.types import InputError

    found = load_experiment(experiment, overrides)
    name = f"learned_{found.name.removeprefix('learned_')}"
    target = Path(out) if out else Path(f"{name}.yaml")
    for path in (target, *([Path(json_file)] if json_file else [])):
        check_place(path)
    learned = run_learn(found, n_blocks=blocks)
    content = learned_yaml(found, learned, target.stem if out else name)
    text = (
        f"# Learned by `egolane learn {Path(experiment).name}` from all labelled frames of its"
        " recording\n# (crossing ones and those of tuning.never_fit left out).\n"
        + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    )
    try:
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}") from error
    scored, everywhere = learned.scores["frames_scored"], learned.scores_all["frames_scored"]
    click.echo(f"{found.name}: held out, {blocks} blocks, {scored} frames scored")
    click.echo(scores_table({"model": learned.scores}))
    if everywhere != scored:
        click.echo(f"\nthe same over all {everywhere} frames, labels never fitted included")
        click.echo(scores_table({"model": learned.scores_all}))
    click.echo(f"\nwritten to {target}")
    if json_file:
        write_json(
            Path(json_file),
            {
                "schema_version": SCHEMA_VERSION,
                "name": found.name,
                "blocks": blocks,
                "held_out": dict(learned.scores),
                "held_out_all_frames": dict(learned.scores_all),
                "parameters": content["parameters"],
            },
        )
