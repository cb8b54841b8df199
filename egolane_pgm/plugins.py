"""Find and import plugins: graphs, evidence rules, readers and detectors.

A plugin is a module that defines the names of its folder's contract (`build`, `evidence`, ...): one
of this package or of another installed one, by name, or a user's file. A graph may also be a file
that pgmpy reads, or Python with a pgmpy network at its top level, which `build` then returns.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from egolane_pgm.parameters import Parameter
from egolane_pgm.types import InputError, suggestion

#: The names that a module of each folder must define.
CONTRACTS = {
    "graphs": ("build",),
    "evidence": ("evidence",),
    "recordings": ("read",),
    "detectors": ("STEREO", "start"),
}

_PACKAGE = Path(__file__).parent

#: The folders of the package's plugins of each kind.
_PLACES = {
    **{folder: [_PACKAGE / folder] for folder in CONTRACTS},
    "detectors": [_PACKAGE / "vision/detectors", _PACKAGE / "classic"],
}

#: The prefix of the module names of users' files.
_OWN = "_egolane_plugin_"

#: The suffixes of users' files.
OWN_FILES = (".py", ".yaml", ".yml", ".bif", ".xmlbif", ".xml")


def plugin_names(folder: str) -> list[str]:
    """List the plugins of a kind (a key of CONTRACTS), of this and other installed packages.

    A module is a plugin if it defines the first name of the contract, a folder if its `__all__` has
    that name. Files are searched as text, because importing them all is slow.
    """
    names = {entry.name for entry in _entry_points(folder)}
    for place in _PLACES[folder]:
        names |= {file.stem for file in place.glob("*.py") if _module_of(folder, file.stem)}
        inside = {file.parent.name for file in place.glob("*/*.py")}
        names |= {name for name in inside if _module_of(folder, name)}
    return sorted(names)


def _entry_points(folder: str) -> list[EntryPoint]:
    """The plugins of a kind in other installed packages."""
    return list(entry_points(group=f"egolane_pgm.{folder}"))


def _module_of(folder: str, name: str) -> str | None:
    """Return the module of a plugin of this package, or None."""
    first = CONTRACTS[folder][0]
    for place in _PLACES[folder] if name.isidentifier() else ():
        file, package = place / f"{name}.py", place / name / "__init__.py"
        is_file = file.is_file() and _defines(file.read_text(encoding="utf-8"), first)
        if is_file or (package.is_file() and f'"{first}"' in package.read_text("utf-8")):
            inside = place.relative_to(_PACKAGE)
            return ".".join(("egolane_pgm", *inside.parts, name))
    return None


def _defines(text: str, name: str) -> bool:
    return re.search(rf"^(def )?{name}\b", text, re.MULTILINE) is not None


def find_plugin(name: str, kinds: Mapping[str, str], base: Path) -> tuple[str, str]:
    """Return the kind of a plugin, and its name without the kind.

    - name: as for `load_plugin`, optionally with its kind: `graph:./mine.py`.
    - kinds: the folder of each kind.

    Raises InputError for an unknown name, and for one of several kinds.
    """
    kind, _, rest = name.partition(":")
    if rest and kind in kinds:
        return kind, rest
    file = base / name
    if name.endswith(".py") and file.is_file():
        text = file.read_text(encoding="utf-8", errors="replace")
        found = [kind for kind in kinds if _defines(text, CONTRACTS[kinds[kind]][0])]
        found = found or ["graph"]
    elif name.endswith(OWN_FILES):
        found = ["graph"]
    else:
        found = [kind for kind in kinds if name in plugin_names(kinds[kind])]
    if not found:
        known = [known for folder in kinds.values() for known in plugin_names(folder)]
        raise InputError(f"unknown name '{name}'{suggestion(name, known)}")
    if len(found) > 1:
        several = " or ".join(f"{kind}:{name}" for kind in found)
        raise InputError(f"{name} is of several kinds; write {several}")
    return found[0], name


def load_plugin(folder: str, name: str, where: str) -> ModuleType:
    """Import a plugin.

    - folder: a key of CONTRACTS.
    - name: a plugin of that folder, or a file (.py; for a graph any of OWN_FILES).
    - where: prefix of messages, e.g. the YAML file and the key.

    Raises InputError for an unknown name, a missing file, a file that cannot be imported and one
    that does not meet the contract.
    """
    # `resolve` raises for a link to itself.
    file = Path(os.path.realpath(name))
    if name.endswith(OWN_FILES if folder == "graphs" else ".py") and not file.is_file():
        raise InputError(f"{where}: no file {file}")
    if name.endswith(".py"):
        module = _load_file(file, where)
        if folder == "graphs" and not hasattr(module, "build"):
            _build_from_network(module, f"{where}: {name}")
    elif name.endswith(OWN_FILES) and folder == "graphs":
        # Graphs are above this module in the layers.
        is_yaml = name.endswith((".yaml", ".yml"))
        reader = importlib.import_module(
            f"egolane_pgm.graphs.{'yaml_graph' if is_yaml else 'from_pgmpy'}"
        )
        module = reader.load_graph_file(file, f"{_OWN}{Path(name).stem}", where)
    elif (own := _module_of(folder, name)) is not None:
        module = importlib.import_module(own)
    elif offered := [entry for entry in _entry_points(folder) if entry.name == name]:
        try:
            module = offered[0].load()
        except Exception as error:
            problem = f"{offered[0].value} cannot be imported: {_one_line(error)}"
            raise InputError(f"{where}: {problem}") from error
    else:
        raise InputError(f"{where}: unknown name '{name}'{suggestion(name, plugin_names(folder))}")
    for needed in CONTRACTS[folder]:
        if not hasattr(module, needed):
            raise InputError(f"{where}: {name} does not define {needed}")
    specs = getattr(module, "PARAMETERS", ())
    if not isinstance(specs, (tuple, list)):
        raise InputError(f"{where}: {name}: PARAMETERS is not a tuple of Parameter")
    for spec in specs:
        if not isinstance(spec, Parameter):
            raise InputError(f"{where}: {name}: PARAMETERS has {spec!r}, not a Parameter")
    return module


def plugin_place(module: ModuleType) -> str:
    """Return the name with which `load_plugin` finds a plugin: its name, or a file's path."""
    if module.__name__.startswith(_OWN):
        return str(module.__file__)
    if not module.__name__.startswith("egolane_pgm."):
        offered = [entry for folder in CONTRACTS for entry in _entry_points(folder)]
        return next(entry.name for entry in offered if entry.module == module.__name__)
    return module.__name__.rpartition(".")[2]


def declared_parameters(rule: ModuleType, graph: ModuleType) -> list[Parameter]:
    """Return the parameters of an evidence rule and a graph; a common one is shared."""
    specs = {p.name: p for p in getattr(rule, "PARAMETERS", ())}
    for p in getattr(graph, "PARAMETERS", ()):
        if p.name in specs and specs[p.name].kind != p.kind:
            raise InputError(f"parameters.{p.name}: graph and evidence rule declare it differently")
        specs[p.name] = p
    return list(specs.values())


def _build_from_network(module: ModuleType, where: str) -> None:
    """Add a `build` that returns the pgmpy network at the module's top level.

    Raises InputError for a module with no network or several.
    """
    found = {
        id(value): (name, value)
        for name, value in vars(module).items()
        if hasattr(value, "get_cpds") and not isinstance(value, type)
    }
    if len(found) != 1:
        names = ", ".join(name for name, _ in found.values())
        has = f"and has {len(found)} pgmpy networks ({names})" if found else "nor a pgmpy network"
        raise InputError(f"{where} does not define build, {has} at its top level")
    [(_, network)] = found.values()
    vars(module)["build"] = lambda n_lanes, parameters: network


def _load_file(path: Path, where: str) -> ModuleType:
    source = path.read_bytes()
    # One module per path and content, so that two experiments may each have a my_graph.py.
    digest = hashlib.sha256(str(path).encode() + source).hexdigest()[:16]
    name = f"{_OWN}{path.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        # An import would write __pycache__, and miss a change within the same second.
        exec(compile(source, path, "exec"), vars(module))
    except Exception as error:
        del sys.modules[name]
        at = f" (line {line})" if (line := _line_in(str(path), error)) else ""
        raise InputError(f"{where}: {path} cannot be imported: {_one_line(error)}{at}") from error
    return module


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _line_in(file: str, error: Exception) -> int | None:
    """Return the line of the file that raised an error."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    return lines[-1] if lines else None


@contextlib.contextmanager
def plugin_errors(module: ModuleType, where: str) -> Iterator[None]:
    """Turn an exception of a user's plugin into an InputError with its file and line.

    Exceptions of this package's plugins are bugs and pass.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, InputError) or module.__name__.startswith("egolane_pgm."):
            raise
        line = _line_in(str(module.__file__), error)
        at = f"{module.__file__}, line {line}" if line else f"{module.__file__}"
        raise InputError(f"{where}: {at}: {_one_line(error)}") from error
