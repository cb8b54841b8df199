"""The YAML of a network: each mistake in it is one line of the message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.detectors.networks.description import read_network
from tests.kits.tiny_network import write_answer, write_network

GOOD: dict[str, Any] = {"model": "x.onnx", "size": [640, 360], "layout": "lanes", "classes": 2}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_answer(tmp_path, np.zeros((1, 2, 4, 8)))
    (tmp_path / "known.onnx").rename(tmp_path / "x.onnx")
    return tmp_path


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"sise": [1, 2]}, "unknown key 'sise' (did you mean 'size'?)"),
        ({"layout": "lane"}, "layout: input should be 'lanes', 'instances'"),
        ({"classes": None}, "layout lanes needs classes"),
        ({"rows": "culane"}, "rows: goes with layout row_anchors or hybrid_anchors only"),
        ({"layout": "row_anchors"}, "layout row_anchors needs rows"),
        ({"classes": 1, "activation": "softmax"}, "softmax needs several classes"),
        (
            {"layout": "prototypes", "output": {"box": "x"}},
            "layout prototypes reads boxes, prototypes",
        ),
        ({"classes": {"solid": [1]}}, "lines of layout lanes have none; give their number"),
        ({"mean": float("nan")}, "input should be a finite number"),
        ({"cut_top": 1}, "cut_top: input should be less than 1"),
    ],
)
def test_keys_that_do_not_fit_are_refused(folder: Path, keys: dict[str, Any], message: str) -> None:
    path = write_network(folder / "net.yaml", **{**GOOD, **keys})
    with pytest.raises(InputError) as caught:
        read_network(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_ready_network_needs_the_onnx_only(folder: Path) -> None:
    """It is looked for beside the place that was named; a file of that name goes before it."""
    (folder / "x.onnx").rename(folder / "lstr_360x640.onnx")
    named = folder / "lstr.yaml"
    for path in (folder / "lstr", named):
        assert read_network(path).model == str(folder / "lstr_360x640.onnx")
    write_network(named, **{**GOOD, "model": "lstr_360x640.onnx"})
    assert read_network(named).layout == "lanes"


@pytest.mark.parametrize(
    ("name", "hint"), [("", ""), ("none", ""), ("lsrt", r"\(did you mean 'lstr'\?\)")]
)
def test_an_unknown_network_is_refused(name: str, hint: str) -> None:
    with pytest.raises(InputError, match=r"x\.onnx is the ONNX file; give the YAML that describes"):
        read_network("x.onnx")
    with pytest.raises(InputError, match=rf"^network: '.*{name}' is not the YAML of .*{hint}"):
        read_network(name)
