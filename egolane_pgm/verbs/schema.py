"""JSON Schemas (draft 2020-12) of the YAML files, for editors and the reference."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from egolane_pgm.contracts import Detector, Graph, Rule
from egolane_pgm.experiment import Experiment
from egolane_pgm.plugins import OWN_FILES, plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.simulation import PRESETS
from egolane_pgm.tools.files import YAML_VERSION
from egolane_pgm.verbs.studied import TuningFile

#: The files that have a schema, and their models.
KINDS: dict[str, Any] = {"experiment": Experiment, "tuning": TuningFile}

#: Keys of YAML files that are not fields of the models.
_VERSION = {
    "const": YAML_VERSION,
    "default": YAML_VERSION,
    "description": "version of the format",
}
_INCLUDE = {
    "type": "string",
    "description": "YAML file, relative to this one, that gives the missing keys",
    "examples": ["_shared.yaml"],
}


class _Untitled(GenerateJsonSchema):
    """Leaves out titles, which would repeat the names of the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema(kind: str = "experiment") -> dict[str, Any]:
    """The JSON Schema of a YAML file.

    Unknown keys are refused; names of the package's plugins are checked, a user's files are not. A
    file with `include` may lack keys, and so may a file without `name`, which others include.
    """
    found = TypeAdapter(KINDS[kind]).json_schema(schema_generator=_Untitled)
    found["properties"] = {"version": _VERSION, **found["properties"]}
    if "name" in found["required"]:
        found["properties"] = {"include": _INCLUDE, **found["properties"]}
        needed = [key for key in found.pop("required") if key != "name"]
        found["if"] = {"required": ["name"]}
        found["then"] = {"anyOf": [{"required": needed}, {"required": ["include"]}]}
    for key, names, endings in (
        ("graph", plugin_names(Graph), OWN_FILES),
        ("evidence", plugin_names(Rule), (".py",)),
        ("simulate", [*PRESETS], ()),
        ("format", [*FORMATS], (".py",)),
        ("detector", plugin_names(Detector), (".py",)),
    ):
        for section in (found, found.get("$defs", {}).get("Recording", {})):
            if key in section.get("properties", {}):
                _one_of(section["properties"][key], names, endings)
    title = f"egolane_pgm: {'an' if kind == 'experiment' else 'a'} {kind} file"
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        "$id": f"urn:egolane-pgm:{kind}:{YAML_VERSION}",
        **found,
        "title": title,
    }


def _one_of(key: dict[str, Any], names: Iterable[str], endings: Iterable[str]) -> None:
    """Limit a key to some names, or to files with some extensions."""
    other = [each for each in key.pop("anyOf", []) if each.get("type") == "null"]
    key.pop("type", None)
    files = "|".join(ending.lstrip(".") for ending in endings)
    own = [{"type": "string", "pattern": rf"\.({files})$"}] if files else []
    key["anyOf"] = [{"enum": sorted(names)}, *own, *other]
