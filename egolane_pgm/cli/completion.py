"""What the tab key completes beside what click knows itself: the names of graphs, rules, ..."""

from __future__ import annotations

from collections.abc import Callable

import click
from click.shell_completion import CompletionItem

from egolane_pgm.plugins import plugin_names

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def plugins(*folders: str) -> Complete:
    """Completes names of the package's plugins, several with commas between them, or of files."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        *before, last = incomplete.split(",")
        known = sorted(name for folder in folders for name in plugin_names(folder))
        found = [",".join([*before, name]) for name in known if name.startswith(last)]
        return list(map(CompletionItem, found)) or [CompletionItem(incomplete, type="file")]

    return complete
