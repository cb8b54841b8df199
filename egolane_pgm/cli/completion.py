"""What a shell completes, by click. A press of the tab key starts a process, so that nothing but
click and the files of the commands is imported for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import click
from click.shell_completion import CompletionItem

#: What is imported for completion beside Python's own modules.
_NEEDED = ("egolane_pgm.cli", "egolane_pgm.plugins", "egolane_pgm.tuning.search", "click")


class _Unknown(str):
    """Whatever a module that is not imported has: a text without letters, a function that does
    nothing, a type."""

    def __call__(self, *_: Any, **__: Any) -> _Unknown:
        return self

    def __ror__(self, _: Any) -> _Unknown:
        return self

    def __getattr__(self, name: str) -> _Unknown:
        if name.startswith("__"):
            raise AttributeError(name)
        return self


class _Light(MetaPathFinder, Loader):
    """Finds every other module, empty."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        is_python = name.partition(".")[0] in sys.stdlib_module_names
        is_needed = any(f"{needed}.".startswith(f"{name}.") for needed in _NEEDED)
        if is_python or is_needed or name.startswith(("egolane_pgm.cli.", "click.")):
            return None
        return ModuleSpec(name, self, is_package=True)

    def exec_module(self, module: ModuleType) -> None:
        def unknown(name: str) -> _Unknown:
            if name.startswith("__"):
                raise AttributeError(name)
            return _Unknown()

        module.__getattr__ = unknown  # type: ignore[method-assign]


def import_lightly() -> None:
    """From here on this process imports only what completion needs; it is of no other use then."""
    sys.meta_path.insert(0, _Light())


Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def files(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completes names of files, as the shell itself does."""
    return [CompletionItem(incomplete, type="file")]


def yaml_files(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completes names of experiments and tuning files, and the folders on the way to them."""
    place = os.path.split(incomplete)[0]
    folder = Path(place)
    if folder.parts[:1] == ("experiments",) and not folder.exists():
        # Those that come with the package have such names everywhere.
        package = Path(__file__).parents[1]
        shipped = (package / "_experiments", package.parent / "experiments")
        folder = next(filter(Path.is_dir, shipped), folder).joinpath(*folder.parts[1:])
    names = [
        os.path.join(place, path.name) + "/" * path.is_dir()
        for path in (sorted(folder.iterdir()) if folder.is_dir() else [])
        if path.is_dir() or path.suffix in (".yaml", ".yml")
    ]
    if not place and "experiments/" not in names:
        names.append("experiments/")
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def samplers(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completes names of samplers."""
    from egolane_pgm.tuning.search import SAMPLERS

    return [CompletionItem(name) for name in SAMPLERS if name.startswith(incomplete)]


def plugins(*folders: str) -> Complete:
    """Completes names of the package's plugins, several with commas between them, or of files."""

    def complete(
        context: click.Context, parameter: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        # Not at the top, because this file says first what is imported lightly.
        from egolane_pgm.plugins import plugin_names

        *before, last = incomplete.split(",")
        start = "".join(f"{word}," for word in before)
        known = sorted(name for folder in folders for name in plugin_names(folder))
        found = [CompletionItem(start + name) for name in known if name.startswith(last)]
        return found or files(context, parameter, incomplete)

    return complete
