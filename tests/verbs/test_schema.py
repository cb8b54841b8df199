"""The JSON Schemas of the YAML files: editors check by them what the program checks."""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from egolane_pgm.loading import experiments_folder
from egolane_pgm.verbs.schema import KINDS, schema
from tests.kits.drives import done

ROOT = Path(__file__).parents[2]

#: Not data sets of parameters, and not graphs.
SHIPPED = [
    path
    for folder in (ROOT / "experiments", ROOT / "examples")
    for path in sorted(folder.rglob("*.yaml"))
    if path.name not in ("published.yaml", "sensor_failure.yaml")
]


def problems(content: Any, kind: str = "experiment") -> list[str]:
    validator = Draft202012Validator(schema(kind))
    return [error.message for error in validator.iter_errors(content)]


def plain(content: Any) -> Any:
    return json.loads(json.dumps(content))


def kind_of(path: Path) -> str:
    return "tuning" if path.parent.name == "tuning" else "experiment"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_file_names_its_schema_and_fits_it(path: Path) -> None:
    kind, first = kind_of(path), path.read_text().splitlines()[0]
    named = experiments_folder() / f"{kind}.schema.json"
    relative = os.path.relpath(named, path.parent)
    assert first == f"# yaml-language-server: $schema={relative}"
    content = plain(yaml.safe_load(path.read_text()))
    assert not problems(content, kind)
    assert problems({**content, "nmae": "x"}, kind)


@pytest.mark.parametrize("kind", ["experiment", "tuning"])
def test_the_kept_schemas_are_what_the_command_prints(kind: str) -> None:
    kept = (experiments_folder() / f"{kind}.schema.json").read_text()
    assert done("show", f"schema:{kind}").stdout == kept, (
        f"egolane show schema:{kind} > experiments/{kind}.schema.json"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_is_valid_and_describes_each_key(kind: str) -> None:
    made = schema(kind)
    Draft202012Validator.check_schema(made)
    for section in [made, *made.get("$defs", {}).values()]:
        for name, key in section.get("properties", {}).items():
            assert key.get("description"), name


GOOD = {
    "name": "mine",
    "recording": {"path": "drive.csv"},
    "n_lanes": 3,
}


@pytest.mark.parametrize(
    ("key", "value", "fits"),
    [
        ("n_lanes", "map", True),
        ("n_lanes", 0, False),
        ("n_lanes", "maps", False),
        ("graph", "./my_graph.py", True),
        ("graph", "position_in_lane", True),
        ("graph", "sensor_failur", False),
        ("evidence", "my_evidence.py", True),
        ("filter", "exakt", False),
        ("fit", {"objective": "accuracy", "untrusted_frames": [[9, None]]}, True),
        ("fit", {"objective": ["accuracy", "log_loss"]}, True),
        ("fit", {"untrusted_frames": {"from": 9}}, False),
        ("recording", {"simulate": "quickstart"}, True),
        ("recording", {"simulate": "quickstar"}, False),
        ("recording", {"path": "drive.csv", "frame_rat": 10}, False),
        ("ground_truth", None, True),
        ("min_confidence", 1.5, False),
    ],
)
def test_the_schema_takes_what_the_program_takes(key: str, value: Any, fits: bool) -> None:
    assert (not problems({**GOOD, key: value})) == fits


def test_keys_may_be_missing_only_where_a_file_includes_another_or_is_included() -> None:
    lacking = copy.deepcopy(GOOD)
    del lacking["n_lanes"]
    assert problems(lacking)
    assert not problems({**lacking, "include": "other.yaml"})
    del lacking["name"]
    assert not problems(lacking)
