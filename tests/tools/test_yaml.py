"""YAML as the package means it, and what is refused of it in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.tools.files import read_yaml, write_yaml
from egolane_pgm.tools.yaml import dump_yaml, parse_yaml


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("010", 10),
        ("0o10", 8),
        ("0x1F", 31),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("-.inf", float("-inf")),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("2020-01-01", "2020-01-01"),
        ("2020-99-99", "2020-99-99"),
        ("yes", True),
        ("~", None),
        ("{1: 2, no: 3, ~: 4}", {"1": 2, "no": 3, "~": 4}),
        ("[&x [1, 2], *x]", [[1, 2], [1, 2]]),
    ],
)
def test_yaml_is_read_as_version_1_2_means_it_and_written_so_that_it_stays(
    text: str, means: object
) -> None:
    assert parse_yaml(f"a: {text}", "x.yaml") == {"a": means}
    assert parse_yaml(dump_yaml({"a": means}), "x.yaml") == {"a": means}
    # A text with these letters stays a text.
    assert parse_yaml(dump_yaml({"a": text, text: 1}), "x.yaml") == {"a": text, text: 1}


def test_an_experiment_is_written_as_it_is_read(tmp_path: Path) -> None:
    content = {"name": "1e3", "path": "0o7", "x": [1e-5, 1e300, -0.0, 10**17], "y": {"no": None}}
    write_yaml(tmp_path / "x.yaml", content)
    assert read_yaml(tmp_path / "x.yaml", "n_lanes: 4") == content
