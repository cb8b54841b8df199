"""The YAML of a network: what is wrong with it is said, all of it, a line each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.runner import find_detector
from tests.kits.tiny_network import write_answer, write_network

GOOD: dict[str, Any] = {"model": "x.onnx", "size": [640, 360], "layout": "lanes", "classes": 2}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_answer(tmp_path, np.zeros((1, 2, 4, 8)))
    (tmp_path / "known.onnx").rename(tmp_path / "x.onnx")
    return tmp_path


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"sise": [1, 2]}, "unknown key 'sise' (did you mean 'size'?)"),
        ({"layout": "lane"}, "layout: 'lane' is not one of lanes, instances,"),
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
def test_what_does_not_fit_is_said(folder: Path, keys: dict[str, Any], said: str) -> None:
    path = write_network(folder / "net.yaml", **{**GOOD, **keys})
    with pytest.raises(InputError) as caught:
        read_network(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_network_that_comes_along_needs_the_onnx_only(folder: Path) -> None:
    """It is looked for beside the place that was named; a file of that name goes before it."""
    (folder / "x.onnx").rename(folder / "lstr_360x640.onnx")
    detector = find_detector("network", {"network": "lstr"}, folder, "detector")
    named = folder.resolve() / "lstr.yaml"
    assert detector.parameters["network"] == str(named)
    assert read_network(named).model == str(folder.resolve() / "lstr_360x640.onnx")
    write_network(named, **{**GOOD, "model": "lstr_360x640.onnx"})
    assert read_network(named).layout == "lanes"


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("network", {}, "here_parameters.network: '' is not the name of a .yaml file; it"),
        ("network", {"network": "none"}, "'none' is not the name of a .yaml file"),
        ("network", {"network": "lsrt"}, "(docs/networks.md) (did you mean 'lstr'?)"),
        ("ml", {"lri_frame": 3}, "unknown key 'lri_frame' (did you mean 'lri_frames'?)"),
    ],
)
def test_a_parameter_that_is_no_network_is_refused(
    name: str, given: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        find_detector(name, given, Path.cwd(), "here")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
