"""The command `egolane schema`."""

from __future__ import annotations

import json

import click

from egolane_pgm.api.schemas import KINDS, json_schema


@click.command()
@click.argument("kind", type=click.Choice(list(KINDS)), default="experiment", metavar="[KIND]")
def schema(kind: str) -> None:
    """Print the JSON Schema of a YAML file, by which an editor completes and checks its keys.

    KIND is experiment (the default), tuning, or network (which describes a lane network); or
    comparison or reproduction, which `compare --json` and `reproduce --json` write.

    \b
    egolane schema > experiment.schema.json

    An editor with YAML's language server reads it where the first line of a YAML names it:

    \b
    # yaml-language-server: $schema=experiment.schema.json
    """
    click.echo(json.dumps(json_schema(kind), indent=1))
