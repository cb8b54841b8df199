"""YAML is written as it is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.tools.files import read_yaml, write_yaml
from egolane_pgm.tools.yaml import dump_yaml, parse_yaml


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("1e3", 1000.0),
        (".5", 0.5),
        ("-.inf", float("-inf")),
        ("yes", True),
        ("~", None),
        ("{1: 2, no: 3, ~: 4}", {"1": 2, "no": 3, "~": 4}),
        ("[&x [1, 2], *x]", [[1, 2], [1, 2]]),
    ],
)
def test_yaml_is_read_and_written_so_that_it_stays(text: str, means: object) -> None:
    assert parse_yaml(f"a: {text}", "x.yaml") == {"a": means}
    assert parse_yaml(dump_yaml({"a": means}), "x.yaml") == {"a": means}
    # A text with these letters stays a text.
    assert parse_yaml(dump_yaml({"a": text, text: 1}), "x.yaml") == {"a": text, text: 1}


def test_an_experiment_is_written_as_it_is_read(tmp_path: Path) -> None:
    content = {"name": "1e3", "path": "0o7", "x": [1e-5, 1e300, -0.0, 10**17], "y": {"no": None}}
    write_yaml(tmp_path / "x.yaml", content)
    assert read_yaml(tmp_path / "x.yaml", "n_lanes: 4") == content
