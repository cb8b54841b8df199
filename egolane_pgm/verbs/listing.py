"""The names of plugins, experiments and others that come with the package, by kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from egolane_pgm.loading import experiments_folder, load_yaml
from egolane_pgm.plugins import plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.simulation import PRESETS
from egolane_pgm.verbs.options import shown
from egolane_pgm.views.tables import line_width
from egolane_pgm.vision.detectors.networks.description import ready_networks


def _descriptions(is_tuning: bool) -> dict[str, str]:
    """The description of each experiment, or of each tuning file, by its path."""
    return {
        shown(path): load_yaml(path).get("description", "")
        for path in yaml_files()
        if (path.parent.name == "tuning") == is_tuning
    }


def yaml_files() -> Iterator[Path]:
    """The experiments and tuning files."""
    for path in sorted(experiments_folder().rglob("*.yaml")):
        if path.name[0] != "_" and path.name != "published.yaml":
            yield path


#: Names, or for files a description by path, of each kind.
KINDS: dict[str, Callable[[], list[str] | dict[str, str]]] = {
    "graphs": lambda: plugin_names("graphs"),
    "evidence": lambda: plugin_names("evidence"),
    "detectors": lambda: plugin_names("detectors"),
    "networks": lambda: [*ready_networks()],
    "recordings": lambda: [*FORMATS, *plugin_names("recordings")],
    "simulations": lambda: sorted(PRESETS),
    "experiments": lambda: _descriptions(is_tuning=False),
    "tuning": lambda: _descriptions(is_tuning=True),
}


def listed(kind: str | None) -> dict[str, Any]:
    """The names of one kind, or of all."""
    return {name: names() for name, names in KINDS.items() if kind in (None, name)}


def list_text(found: Mapping[str, Any]) -> str:
    """A list as text that fits the terminal."""
    text = click.HelpFormatter(width=line_width())
    rows = [
        (f"{kind}:", ", ".join(found[kind])) for kind in KINDS if isinstance(found.get(kind), list)
    ]
    if rows:
        text.write_dl(rows)
    for kind, title in (("experiments", "experiments"), ("tuning", "tuning files")):
        if kind in found:
            with text.section(title):
                text.write_dl([*found[kind].items()], col_max=4)
    return text.getvalue().rstrip("\n")
