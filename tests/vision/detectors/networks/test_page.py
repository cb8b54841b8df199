"""The networks of docs/networks.md, by stand-ins: ONNX files of the same inputs and outputs, which
say where the lines of a drawn road are as the published code of each network writes it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import image_to_road, road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.description import Network, read_network
from egolane_pgm.vision.detectors.networks.layouts import from_above
from egolane_pgm.vision.detectors.networks.looking import looker
from egolane_pgm.vision.detectors.networks.running import Fit, fit_of
from egolane_pgm.vision.detectors.runner import detect, find_detector
from egolane_pgm.vision.detectors.simple.birdseye import make_view
from tests.kits.synthetic_road import CAMERA, Paint, drive, road
from tests.kits.tiny_network import write_known

PAGE = (Path(__file__).parents[4] / "docs" / "networks.md").read_text()
DESCRIBED = [text for text in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL) if "model:" in text]

#: Offsets of the lines that the stand-ins see, metres.
OFFSETS = np.array([-2.9, 0.1, 3.1])


def place(network: Network, fit: Fit) -> FloatArray:
    """Where the lines are in each row of the input, (lines, h); NaN above the horizon and in rows
    that no part of the picture is in."""
    rows = np.arange(network.size[1], dtype=float)
    _, v = fit.to_picture(np.zeros(len(rows)), rows)
    far = np.geomspace(1, 200, 4000)[::-1]
    found = []
    for offset in OFFSETS:
        u, at = road_to_image(CAMERA, far, offset)
        seen = np.interp(v, at, u, left=np.nan, right=np.nan)
        seen[(v < 0) | (v > CAMERA.height - 1)] = np.nan
        found.append((seen + 0.5) * fit.wide / fit.width - 0.5 + fit.left)
    return np.array(found)


def area(network: Network, fit: Fit) -> FloatArray:
    """The probability of free road: between the outermost lines, (h, w)."""
    x = place(network, fit)
    u = np.arange(network.size[0])
    return np.where((u > x[0][:, None]) & (u < x[-1][:, None]), 0.9, 0.1)


def strips(network: Network, fit: Fit) -> FloatArray:
    """The probability of each line's marking, 0.2 m wide and two pixels at least, (lines, h, w)."""
    u, v = np.meshgrid(*(np.arange(float(n)) for n in network.size))
    _, y = image_to_road(CAMERA, *fit.to_picture(u, v))
    away = np.abs(u - place(network, fit)[:, :, None])
    near = np.abs(y - OFFSETS[:, None, None]) < 0.1
    return np.where(near | (away < 1), 0.9, 0.05)


def two_classes(share: FloatArray) -> FloatArray:
    return np.stack([1 - share, share])[None]


def twinlitenet(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """Logits of two classes."""
    return {
        "da": np.log(two_classes(area(network, fit))),
        "ll": np.log(two_classes(strips(network, fit).max(axis=0))),
    }


def yolop(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """The sigmoid is in the file; the first output is that of vehicles."""
    return {
        "det_out": np.zeros((1, 25200, 6)),
        "drive_area_seg": two_classes(area(network, fit)),
        "lane_line_seg": two_classes(strips(network, fit).max(axis=0)),
    }


def ultra_fast(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """`_grid_pts` of data/dataset.py: x // (799 / 199) is a line's class, 200 where there is none.
    The fourth line is nowhere."""
    assert network.rows is not None
    output = np.zeros((1, 201, 18, 4))
    output[0, 200] = 1
    seen = place(network, fit)[:, np.array(network.rows, dtype=int)]
    for line, row in zip(*np.nonzero(np.isfinite(seen)), strict=True):
        column = int(seen[line, row] // (799 / 199))
        if 0 <= column < 200:
            output[0, column, row, line] = 30
    return {"output": output}


def clrnet(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """`get_lanes` of clr_head.py: x at `np.linspace(1, 0, 72)` of the height, as shares of the
    width; the start is a share of 71 strips, and so is the length."""
    output = np.zeros((1, 192, 78))
    output[0, :, 0] = 3
    for k, (x, first, n) in enumerate(at_72(network, fit)):
        output[0, 5 * k, :6] = (0, 3, first / 71, 0.5, 0.5, n / 71)
        output[0, 5 * k, 6:] = x / (network.size[0] - 1)
    return {"output": output}


def laneatt(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """`proposals_to_pred` of laneatt.py: x in pixels, the length in rows."""
    output = np.zeros((1, 1000, 77))
    output[0, :, 0] = 3
    for k, (x, first, n) in enumerate(at_72(network, fit)):
        output[0, 5 * k, :5] = (0, 3, first / 71, 0.5, n)
        output[0, 5 * k, 5:] = x
    return {"proposals": output}


def at_72(network: Network, fit: Fit) -> list[tuple[FloatArray, int, int]]:
    """Each line at 72 rows from the bottom up: its x (0 where it is not), its first row and how
    many there are."""
    height = network.size[1]
    found = []
    for line in place(network, fit):
        x = np.interp(np.linspace(1, 0, 72) * (height - 1), np.arange(height), line)
        there = np.flatnonzero((x >= 0) & (x <= network.size[0] - 1))
        found.append((np.nan_to_num(x), int(there[0]), len(there)))
    return found


def scnn(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """Logits of a background and four lines, the last of which is nowhere."""
    share = np.zeros((1, 5, *network.size[::-1])) + 0.01
    share[0, 1:4] = strips(network, fit)
    share[0, 0] = np.maximum(1 - share[0, 1:].sum(axis=0), 0.01)
    return {"seg_pred": np.log(share), "exist_pred": np.ones((1, 4))}


#: What the network of each file gives.
GIVES: dict[str, Callable[[Network, Fit], dict[str, FloatArray]]] = {
    "twinlitenet.onnx": twinlitenet,
    "yolop-640-640.onnx": yolop,
    "culane_18.onnx": ultra_fast,
    "tusimple_r18.onnx": clrnet,
    "laneatt_r18_tusimple.onnx": laneatt,
    "scnn.onnx": scnn,
}


def written(folder: Path, text: str) -> Path:
    """A YAML of the page with its stand-in beside it."""
    path = folder / "network.yaml"
    path.write_text(text)
    name = yaml.safe_load(text)["model"]
    (folder / name).touch()
    network = read_network(path)
    outputs = GIVES[name](network, fit_of(network, CAMERA.width, CAMERA.height))
    write_known(folder / name, outputs, network.size)
    return path


@pytest.mark.parametrize("text", DESCRIBED)
def test_each_yaml_of_the_page_reads_what_its_network_writes(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    network = read_network(path)
    view = make_view(CAMERA, 6.0, 14.0, -5.0, 5.0)
    answer = looker(network, CAMERA)(Picture(0, road()))
    assert answer is not None
    above = from_above(view, answer) > 0
    if network.layout == "drivable":
        between = (view.y_m > OFFSETS[0]) & (view.y_m < OFFSETS[-1])
        edge = np.abs(view.y_m[:, None] - OFFSETS).min(axis=1) < 0.15
        assert (above == between)[:, ~edge].all()
        return
    away = np.abs(view.y_m[:, None] - OFFSETS)
    assert not above[:, away.min(axis=1) > 0.3].any()
    for line in range(len(OFFSETS)):
        found = above[:, away[:, line] < 0.3]
        assert found.any(axis=1).mean() > 0.9
        middle = view.y_m[away[:, line] < 0.3][np.nonzero(found)[1]].mean()
        assert abs(middle - OFFSETS[line]) < 0.06


@pytest.mark.parametrize("text", [text for text in DESCRIBED if "layout: drivable" not in text])
def test_each_network_of_the_page_with_lines_is_a_detector(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    given = {"network": str(path), "curve": "line"}
    detector = find_detector("network", given, Path.cwd(), "detector")
    *_, (_, last) = detect(detector, CAMERA, drive(11, [Paint(-1.7, grey=95)]))
    assert last.is_valid.all()
    np.testing.assert_allclose(last.offset_m, OFFSETS, atol=0.15)


def test_the_page_has_each_layout_and_each_key() -> None:
    layouts = {yaml.safe_load(text)["layout"] for text in DESCRIBED}
    assert layouts == {"drivable", "lanes", "instances", "row_anchors", "polylines"}
    assert {yaml.safe_load(text)["model"] for text in DESCRIBED} == set(GIVES)
    for key in Network.model_fields:
        assert f"`{key}`" in PAGE
