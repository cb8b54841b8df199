"""Find and import plugins: graphs, evidence rules, readers and detectors.

A plugin is a module that defines the names of its folder's contract (`tables`, `evidence`, ...):
one of this package, by name, or a user's file. A graph may also be a file that pgmpy reads, or
Python with a pgmpy network at its top level, which `build` then returns.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import os
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType

from egolane_pgm.parameters import Parameter
from egolane_pgm.types import InputError, suggestion

#: The names that a module of each folder must define; of `a|b` one is needed.
CONTRACTS = {
    "graphs": ("tables|build",),
    "evidence": ("evidence",),
    "recordings": ("read",),
    "detectors": ("STEREO", "start"),
}

_PACKAGE = Path(__file__).parent

#: The prefix of the module names of users' files.
_OWN = "_egolane_plugin_"

#: The suffixes of users' files.
OWN_FILES = (".py", ".yaml", ".yml", ".bif", ".xmlbif", ".xml")


def plugin_names(folder: str) -> list[str]:
    """List the plugins of a kind (a key of CONTRACTS)."""
    return sorted(_modules(folder))


@functools.cache
def _modules(folder: str) -> dict[str, str]:
    """Return the module of each plugin of this package.

    A module is a plugin if it defines the first name of the contract, a folder if its `__all__` has
    that name. Files are searched as text, because importing them all is slow.
    """
    first, found = CONTRACTS[folder][0], {}
    for place in ("vision/detectors", "classic") if folder == "detectors" else (folder,):
        for file in (*_PACKAGE.glob(f"{place}/*.py"), *_PACKAGE.glob(f"{place}/*/__init__.py")):
            is_folder = file.name == "__init__.py"
            text = file.read_text(encoding="utf-8")
            if f'"{first}"' in text if is_folder else _defines(text, first):
                name = file.parent.name if is_folder else file.stem
                found[name] = ".".join(("egolane_pgm", *place.split("/"), name))
    return found


def _defines(text: str, name: str) -> bool:
    return re.search(rf"^(def )?({name})\b", text, re.MULTILINE) is not None


def find_plugin(name: str, kinds: Mapping[str, str]) -> tuple[str, str]:
    """Return the kind of a plugin, and its name without the kind.

    - name: as for `load_plugin`, optionally with its kind: `evidence:./mine.py`. Without it a file
      that meets several contracts is of the first kind.
    - kinds: the folder of each kind.

    Raises InputError for an unknown name.
    """
    kind, _, rest = name.partition(":")
    if rest and kind in kinds:
        return kind, rest
    if name.endswith(".py") and Path(name).is_file():
        text = Path(name).read_text(encoding="utf-8", errors="replace")
        found = [kind for kind in kinds if _defines(text, CONTRACTS[kinds[kind]][0])]
    else:
        found = [kind for kind in kinds if name in _modules(kinds[kind])]
    if found or name.endswith(OWN_FILES) or (Path(name).suffix and Path(name).is_file()):
        return (found or ["graph"])[0], name
    known = [known for folder in kinds.values() for known in _modules(folder)]
    raise InputError(f"unknown name '{name}'{suggestion(name, known)}")


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
    is_file = name.endswith(OWN_FILES if folder == "graphs" else ".py")
    if is_file and not file.is_file():
        raise InputError(f"{where}: no file {file}")
    if name.endswith(".py"):
        module = _load_file(file, where)
        if folder == "graphs" and not {"tables", "build"} & {*vars(module)}:
            _build_from_network(module, f"{where}: {name}")
    elif is_file:
        # Graphs are above this module in the layers.
        reader = "yaml_graph" if name.endswith((".yaml", ".yml")) else "from_pgmpy"
        graphs = importlib.import_module(f"egolane_pgm.graphs.{reader}")
        module = graphs.load_graph_file(file, f"{_OWN}{Path(name).stem}", where)
    elif name in (known := _modules(folder)):
        module = importlib.import_module(known[name])
    elif Path(name).suffix and file.is_file():
        kinds = ", ".join(OWN_FILES if folder == "graphs" else (".py",))
        advice = "; export BIF from GeNIe" if name.endswith(".xdsl") else ""
        raise InputError(f"{where}: {name} is none of {kinds}{advice}")
    else:
        raise InputError(f"{where}: unknown name '{name}'{suggestion(name, known)}")
    for needed in CONTRACTS[folder]:
        if not any(hasattr(module, name) for name in needed.split("|")):
            raise InputError(f"{where}: {name} does not define {needed}")
    specs = getattr(module, "PARAMETERS", ())
    if not isinstance(specs, (tuple, list)) or not all(isinstance(s, Parameter) for s in specs):
        raise InputError(f"{where}: {name}: PARAMETERS is not a tuple of Parameter")
    return module


def declared_parameters(rule: ModuleType, graph: ModuleType) -> list[Parameter]:
    """Return the parameters of an evidence rule and a graph; both may declare the same one."""
    both = (*getattr(rule, "PARAMETERS", ()), *getattr(graph, "PARAMETERS", ()))
    return list({spec.name: spec for spec in both}.values())


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
        raise InputError(f"{where} defines neither tables nor build, {has} at its top level")
    [(_, network)] = found.values()
    vars(module)["build"] = lambda n_lanes, parameters: network


def _load_file(path: Path, where: str) -> ModuleType:
    source = path.read_bytes()
    # One module per path and content, so that two experiments may each have a my_graph.py.
    digest = hashlib.sha256(str(path).encode() + source).hexdigest()[:16]
    name = f"{_OWN}{path.stem}_{digest}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = str(path)
        try:
            with plugin_errors(module, where):
                # An import would write __pycache__, and miss a change within the same second.
                exec(compile(source, path, "exec"), vars(module))
        except InputError:
            del sys.modules[name]
            raise
    return sys.modules[name]


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
        frames = traceback.extract_tb(error.__traceback__)
        lines = [f", line {f.lineno}" for f in frames if f.filename == module.__file__]
        at = f"{module.__file__}{lines[-1] if lines else ''}"
        raise InputError(f"{where}: {at}: {type(error).__name__}: {error}") from error
