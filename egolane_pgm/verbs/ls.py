"""The verb `ls`."""

from __future__ import annotations

import click

from egolane_pgm.experiment import experiments_folder, load_experiment, load_yaml
from egolane_pgm.plugins import plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.simulation import PRESETS
from egolane_pgm.verbs.given import shown
from egolane_pgm.views.tables import line_width
from egolane_pgm.vision.detectors.networks.description import ready_networks

EXAMPLES = ("egolane ls",)


def ls() -> str:
    """List graphs, evidence rules, detectors, networks, simulated drives and experiments that come
    along."""
    files = sorted(experiments_folder().rglob("*.yaml"))
    listed = [path for path in files if path.name[0] != "_" and path.name != "published.yaml"]
    text = click.HelpFormatter(width=line_width())
    text.write_dl(
        [
            ("graphs:", ", ".join(plugin_names("graphs"))),
            ("evidence:", ", ".join(plugin_names("evidence"))),
            ("detectors:", ", ".join(plugin_names("detectors"))),
            ("networks:", ", ".join(ready_networks())),
            ("recordings:", ", ".join([*FORMATS, *plugin_names("recordings")])),
            ("simulations:", ", ".join(sorted(PRESETS))),
        ]
    )
    with text.section("experiments"):
        text.write_dl(
            [
                (shown(path), load_experiment(path).description)
                for path in listed
                if path.parent.name != "tuning"
            ],
            col_max=4,
        )
    with text.section("tuning files (for `egolane tune`)"):
        text.write_dl(
            [
                (shown(path), load_yaml(path).get("description", ""))
                for path in listed
                if path.parent.name == "tuning"
            ],
            col_max=4,
        )
    return text.getvalue().rstrip("\n")
