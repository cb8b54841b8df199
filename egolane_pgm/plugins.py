"""Find plugins (graphs, evidence rules, detectors, readers), and read their contracts.

A plugin is a module of this package, by name, or a user's file. A graph may also be a file that
pgmpy reads, or Python with a pgmpy network at its top level.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import inspect
import os
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError
from typing_extensions import is_protocol

from egolane_pgm.contracts import Graph, Plugin, Rule
from egolane_pgm.parameters import Parameter
from egolane_pgm.types import InputError, near_word, suggestion

AnyPlugin = TypeVar("AnyPlugin", bound=Plugin)

_PACKAGE = Path(__file__).parent

#: The prefix of the module names of users' files.
_OWN = "_egolane_plugin_"

#: The suffixes of users' files.
OWN_FILES = (".py", ".yaml", ".yml", ".bif", ".xmlbif", ".xml")

#: The fields that a module does not define.
_OF_FILE = ("name", "file", "about", "is_ours", "keys")


def plugin_names(kind: type[Plugin]) -> list[str]:
    """List the plugins of this package of a kind."""
    return sorted(_modules(kind.folder, kind.marks))


@functools.cache
def _modules(folder: str, marks: str) -> dict[str, str]:
    """Return the module of each plugin of this package.

    A module is a plugin if it defines one of the marks of its kind, a folder if its `__all__` has
    one. Files are searched as text, because importing them all is slow.
    """
    found = {}
    for place in ("vision/detectors", "classic") if folder == "detectors" else (folder,):
        for file in (*_PACKAGE.glob(f"{place}/*.py"), *_PACKAGE.glob(f"{place}/*/__init__.py")):
            is_folder = file.name == "__init__.py"
            text = file.read_text(encoding="utf-8")
            if f'"{marks}"' in text if is_folder else _defines(text, marks):
                name = file.parent.name if is_folder else file.stem
                found[name] = ".".join(("egolane_pgm", *place.split("/"), name))
    return found


def _defines(text: str, marks: str) -> bool:
    return re.search(rf"^(def )?({marks})\b", text, re.MULTILINE) is not None


def find_plugin(name: str, kinds: Mapping[str, type[Plugin]]) -> tuple[str, str]:
    """Return the kind of a plugin, and its name without the kind.

    - name: as for `load_plugin`, optionally with its kind: `evidence:./mine.py`. Without it a file
      that meets several contracts is of the first kind.
    - kinds: by name.

    Raises InputError for an unknown name.
    """
    kind, _, rest = name.partition(":")
    if rest and kind in kinds:
        return kind, rest
    if name.endswith(".py") and Path(name).is_file():
        text = Path(name).read_text(encoding="utf-8", errors="replace")
        found = [word for word, kind in kinds.items() if _defines(text, kind.marks)]
    else:
        found = [word for word, kind in kinds.items() if name in plugin_names(kind)]
    if found or name.endswith(OWN_FILES) or (Path(name).suffix and Path(name).is_file()):
        return (found or ["graph"])[0], name
    known = [known for kind in kinds.values() for known in plugin_names(kind)]
    raise InputError(f"unknown name '{name}'{suggestion(name, known)}")


def load_plugin(kind: type[AnyPlugin], given: str | AnyPlugin, where: str) -> AnyPlugin:
    """Load a plugin, by its name or from a file.

    - given: a plugin of this package, or a file (.py; for a graph any of OWN_FILES). A plugin
      itself is returned.
    - where: prefix of messages, e.g. the YAML file and the key.

    Raises InputError for an unknown name, a missing file, a file that cannot be imported and one
    that does not meet the contract.
    """
    if isinstance(given, kind):
        return given
    name, is_graph = str(given), issubclass(kind, Graph)
    if name.endswith(OWN_FILES if is_graph else ".py"):
        # `resolve` raises for a link to itself.
        file = Path(os.path.realpath(name))
        if not file.is_file():
            raise InputError(f"{where}: no file {file}")
        if name.endswith(".py"):
            return read_module(kind, _load_file(file, where), name, where)
        # Graphs are above this module in the layers.
        reader = "yaml_graph" if name.endswith((".yaml", ".yml")) else "from_pgmpy"
        read = importlib.import_module(f"egolane_pgm.graphs.{reader}").load_graph_file
        found: AnyPlugin = read(file, name, where)
        return found
    if name in (known := _modules(kind.folder, kind.marks)):
        return read_module(kind, importlib.import_module(known[name]), name, where)
    if Path(name).suffix and Path(name).is_file():
        kinds = ", ".join(OWN_FILES if is_graph else (".py",))
        advice = "; export BIF from GeNIe" if name.endswith(".xdsl") else ""
        raise InputError(f"{where}: {name} is not one of {kinds}{advice}")
    raise InputError(f"{where}: unknown name '{name}'{suggestion(name, known)}")


def declared_parameters(rule: Rule, graph: Graph) -> list[Parameter]:
    """Return the parameters of an evidence rule and a graph; both may declare the same one."""
    return list({spec.name: spec for spec in (*rule.parameters, *graph.parameters)}.values())


# --- modules -------------------------------------------------------------------------------------


def read_module(kind: type[AnyPlugin], module: ModuleType, name: str, where: str) -> AnyPlugin:
    """Read the fields of a contract from a module.

    Raises InputError for a missing or misspelt name, a value of another type, and a function that
    does not take its arguments.
    """
    given, where, values = vars(module), f"{where}: {name}", {}
    is_ours = module.__name__.startswith("egolane_pgm.")
    # A function has its field's name, a value is in capitals.
    contract: Any = kind
    protocols = _protocols(contract)
    own = [f for f in fields(kind) if f.name not in _OF_FILE]
    names = {f.name: f.name if f.name in protocols else f.name.upper() for f in own}
    for word in given if not is_ours else ():
        if word.isupper() and word not in names.values() and near_word(word, names.values()):
            raise InputError(f"{where}: unknown name {word}{near_word(word, names.values())}")
    for field in own:
        word = names[field.name]
        if word in given:
            values[field.name] = given[word]
            if not is_ours:
                check = _check_function if field.name in protocols else _checked
                values[field.name] = check(kind, field, given[word], f"{where}: {word}")
        elif field.default is MISSING:
            raise InputError(f"{where} does not define {word}")
    if issubclass(kind, Graph) and not {"tables", "build"} & {*values}:
        values["build"] = functools.partial(same, _network_in(given, where))
    about = module.__doc__ or ""
    return kind(name=name, file=str(module.__file__), about=about, is_ours=is_ours, **values)


@functools.cache
def _protocols(kind: Any) -> dict[str, Any]:
    """The protocol of each function of a contract, by its field."""
    hints = {name: (hint, *get_args(hint)) for name, hint in get_type_hints(kind).items()}
    return {name: each for name, parts in hints.items() for each in parts if is_protocol(each)}


@functools.cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    return TypeAdapter(hint, config=ConfigDict(arbitrary_types_allowed=True))


def _checked(kind: type[Plugin], field: Field[Any], value: Any, where: str) -> Any:
    """Return a value of its field's type; lists become tuples."""
    try:
        return _adapter(get_type_hints(kind)[field.name]).validate_python(value)
    except ValidationError:
        raise InputError(f"{where}: needs {field.type}, got {value!r:.100}") from None


def _check_function(kind: type[Plugin], field: Field[Any], value: Any, where: str) -> Any:
    """Return a function that can be called as its protocol is."""
    contract: Any = kind
    called = inspect.signature(_protocols(contract)[field.name].__call__).parameters.values()
    needed = [each.name for each in called if each.kind is each.POSITIONAL_ONLY][1:]
    has_options = any(each.kind is each.VAR_KEYWORD for each in called)
    try:
        signature = inspect.signature(value)
        (signature.bind_partial if has_options else signature.bind)(*needed)
    except (TypeError, ValueError):
        raise InputError(f"{where}: needs a function of ({', '.join(needed)})") from None
    return value


def _network_in(given: Mapping[str, Any], where: str) -> Any:
    """Return the pgmpy network among the values of a module; InputError unless there is one."""
    found = {
        id(value): (name, value)
        for name, value in given.items()
        if hasattr(value, "get_cpds") and not isinstance(value, type)
    }
    if len(found) != 1:
        names = ", ".join(name for name, _ in found.values())
        has = f"and has {len(found)} pgmpy networks ({names})" if found else "nor a pgmpy network"
        raise InputError(f"{where} defines neither tables nor build, {has} at its top level")
    [(_, network)] = found.values()
    return network


def same(found: Any, n_lanes: int, parameters: Any) -> Any:
    """Return the same tables, or network, for all parameters."""
    return found


def _load_file(path: Path, where: str) -> ModuleType:
    source = path.read_bytes()
    # One module per path and content, so that two experiments may each have a my_graph.py.
    digest = hashlib.sha256(str(path).encode() + source).hexdigest()[:16]
    name = f"{_OWN}{path.stem}_{digest}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = str(path)
        try:
            with plugin_errors(str(path), where):
                # An import would write __pycache__, and miss a change within the same second.
                exec(compile(source, path, "exec"), vars(module))
        except InputError:
            del sys.modules[name]
            raise
    return sys.modules[name]


@contextlib.contextmanager
def plugin_errors(plugin: Plugin | str, where: str) -> Iterator[None]:
    """Turn an exception of a user's plugin into an InputError with its file and line.

    - plugin: itself, or its file. Exceptions of this package's plugins are bugs and pass.
    """
    try:
        yield
    except Exception as error:
        file = plugin if isinstance(plugin, str) else plugin.file
        is_ours = isinstance(plugin, Plugin) and plugin.is_ours
        if isinstance(error, InputError) or is_ours:
            raise
        frames = traceback.extract_tb(error.__traceback__)
        lines = [f", line {f.lineno}" for f in frames if f.filename == file]
        at = f"{file}{lines[-1] if lines else ''}"
        raise InputError(f"{where}: {at}: {type(error).__name__}: {error}") from error
