"""The networks that come along, by stand-ins: ONNX files of the same inputs and outputs, which say
where the lines of a drawn road are as the published code of each network writes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest

from egolane_pgm.experiment import validated
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import image_to_road, road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.checking import describe_onnx
from egolane_pgm.vision.detectors.networks.description import (
    OUTPUTS,
    READY,
    Network,
    read_network,
    ready_networks,
)
from egolane_pgm.vision.detectors.networks.finding import looker
from egolane_pgm.vision.detectors.networks.running import Fit, fit_of
from egolane_pgm.vision.detectors.simple.birdseye import look, make_view
from tests.kits.drives import command, refused
from tests.kits.synthetic_road import CAMERA, road
from tests.kits.tiny_network import write_known

PAGE = (Path(__file__).parents[4] / "docs" / "networks.md").read_text()

#: `culane_row_anchor` of Ultra-Fast-Lane-Detection.
CULANE_ROWS = [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277]
CULANE_ROWS += [287]

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
    """Logits of two classes; the first output is the drivable area."""
    lanes = np.log(two_classes(strips(network, fit).max(axis=0)))
    return {"da": np.zeros_like(lanes), "ll": lanes}


def yolop(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """The sigmoid is in the file; the first outputs are vehicles and the drivable area."""
    lanes = two_classes(strips(network, fit).max(axis=0))
    vehicles = np.zeros((1, 25200, 6))
    return {"det_out": vehicles, "drive_area_seg": np.zeros_like(lanes), "lane_line_seg": lanes}


def yolopv2(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """`lane_line_mask` rounds its only channel; the others are the drivable area and vehicles."""
    lanes = strips(network, fit).max(axis=0)[None, None]
    vehicles = {f"pred{k}": np.zeros((1, 255, 384 // n, 640 // n)) for k, n in ((0, 8), (1, 16))}
    return {"seg": np.repeat(lanes, 2, axis=1), "ll": lanes, **vehicles}


def hybridnets(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """Logits of background, road and lane; the first outputs are vehicles."""
    lane = strips(network, fit).max(axis=0)
    road = np.full_like(lane, 0.05)
    return {
        "regression": np.zeros((1, 46035, 4)),
        "classification": np.zeros((1, 46035, 1)),
        "segmentation": np.log([[np.maximum(1 - road - lane, 0.01), road, lane]]),
    }


def ultra_fast(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """`_grid_pts` of data/dataset.py: x // (799 / 199) is a line's class, 200 where there is none.
    The fourth line is nowhere."""
    rows = {
        "culane": CULANE_ROWS,
        "tusimple": range(64, 285, 4),
    }[str(network.rows)]
    assert isinstance(network.classes, int)
    columns = network.classes - 1
    output = np.zeros((1, columns + 1, len(rows), 4))
    output[0, columns] = 1
    seen = place(network, fit)[:, np.array(rows, dtype=int)]
    for line, row in zip(*np.nonzero(np.isfinite(seen)), strict=True):
        column = int(seen[line, row] // (799 / (columns - 1)))
        if 0 <= column < columns:
            output[0, column, row, line] = 30
    return {"output": output}


def ultra_fast_2(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """Cells of shares of the picture: rows for the line 1, columns for 0 and 3; 2 is nowhere."""
    n_rows, first, last = {"culane": (72, 0.42, 1), "tusimple": (56, 160 / 720, 710 / 720)}[
        str(network.rows)
    ]
    loc_row, exist_row = np.zeros((1, 200, n_rows, 4)), np.zeros((1, 2, n_rows, 4))
    loc_col, exist_col = np.zeros((1, 100, 81, 4)), np.zeros((1, 2, 81, 4))
    far = np.geomspace(1, 200, 4000)[::-1]
    for line, offset in zip((0, 1, 3), OFFSETS, strict=True):
        u, v = (at + 0.5 for at in road_to_image(CAMERA, far, offset))
        for k, row in enumerate(np.linspace(first, last, n_rows) * CAMERA.height):
            at = np.interp(row, v, u, left=-1, right=-1) / CAMERA.width
            if 0 < at < 1:
                loc_row[0, round(at * 199 - 0.5), k, line] = 30
                exist_row[0, 1, k, line] = 1
        order = np.argsort(u)
        for k, column in enumerate(np.linspace(0, 1, 81) * CAMERA.width):
            at = np.interp(column, u[order], v[order], left=-1, right=-1) / CAMERA.height
            if 0 < at < 1:
                loc_col[0, round(at * 99 - 0.5), k, line] = 30
                exist_col[0, 1, k, line] = 1
    names = ("loc_row", "loc_col", "exist_row", "exist_col")
    return dict(zip(names, (loc_row, loc_col, exist_row, exist_col), strict=True))


def shares(network: Network, fit: Fit) -> list[tuple[FloatArray, FloatArray]]:
    """x and y of each line, shares of the input."""
    rows = np.arange(network.size[1])
    found = []
    for line in place(network, fit):
        there = np.isfinite(line) & (line > 0) & (line < network.size[0])
        x = (line[there] + 0.5) / network.size[0]
        found.append((x, (rows[there] + 0.5) / network.size[1]))
    return found


def lstr(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """A straight line has a slope and two offsets, whose difference counts."""
    scores, curves = np.zeros((1, 7, 2)), np.zeros((1, 7, 8))
    scores[..., 0] = 9
    for k, (x, y) in enumerate(shares(network, fit)):
        slope, start = np.polyfit(y, x, 1)
        scores[0, 2 * k] = (0, 9)
        curves[0, 2 * k] = (y[0], y[-1], 0, -1, 0, start + 0.25, slope, 0.25)
    nothing = np.zeros((1, 240, 240))
    return {"pred_logits": scores, "pred_curves": curves, "weights": nothing}


def yolo_seg(network: Network, fit: Fit) -> dict[str, FloatArray]:
    """Prototypes are a quarter of the size of the input; the class of vehicles is no line."""
    width, height = network.size
    common = np.array([cv2.resize(s, (width // 4, height // 4)) for s in strips(network, fit)])
    common = np.concatenate([20 * (common - 0.3), np.ones((29, height // 4, width // 4))])
    output = np.zeros((1, 4 + 3 + 32, 8400))
    for k, (kind, line) in enumerate(zip((0, 1, 1), place(network, fit), strict=True)):
        left, right = np.clip((np.nanmin(line) - 4, np.nanmax(line) + 4), 0, width)
        output[0, :4, 50 * k] = ((left + right) / 2, height / 2, right - left, height)
        output[0, 4 + kind, 50 * k] = 0.9
        output[0, 7 + k, 50 * k] = 1
    output[0, (0, 1, 2, 3, 6, 37), 1000] = (width / 2, height / 2, 99, 99, 0.9, 1)
    return {"output0": output, "output1": common[None]}


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


#: What each network that comes along gives.
GIVES: dict[str, Callable[[Network, Fit], dict[str, FloatArray]]] = {
    "twinlitenet_lanes": twinlitenet,
    "yolop_lanes": yolop,
    "yolopv2_lanes": yolopv2,
    "hybridnets_lanes": hybridnets,
    "ufld_culane": ultra_fast,
    "ufld_tusimple": ultra_fast,
    "ufldv2_culane": ultra_fast_2,
    "ufldv2_tusimple": ultra_fast_2,
    "scnn": scnn,
    "clrnet": clrnet,
    "laneatt": laneatt,
    "lstr": lstr,
    "yolo_seg": yolo_seg,
}


def written(folder: Path, name: str) -> Path:
    """Where a network that comes along is asked for, its stand-in beside it."""
    path = folder / f"{name}.yaml"
    network = validated(Network, read_yaml(READY / path.name, ""), name)
    outputs = GIVES[name](network, fit_of(network, CAMERA.width, CAMERA.height))
    others = dict.fromkeys(network.inputs, (1, 1, *network.size[::-1]))
    write_known(folder / network.model, outputs, network.size, others)
    return path


@pytest.mark.parametrize("name", ready_networks())
def test_each_yaml_reads_what_its_network_writes(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, name)
    network = read_network(path)
    view = make_view(CAMERA, 6.0, 14.0, -5.0, 5.0)
    answer = looker(network, CAMERA)(Picture(0, road()))
    if isinstance(answer, list):
        assert len(answer) == len(OFFSETS)
        for line in answer:
            x, y = image_to_road(CAMERA, *line.points.T)
            near = (x > 6) & (x < 14)
            away = y[near] - OFFSETS[np.abs(OFFSETS - y[near].mean()).argmin()]
            assert near.sum() > 2
            assert abs(away.mean()) < 0.06
            assert np.abs(away).max() < 0.3
        return
    above = look(view, answer) > 127
    away = np.abs(view.y_m[:, None] - OFFSETS)
    assert not above[:, away.min(axis=1) > 0.3].any()
    for line in range(len(OFFSETS)):
        found = above[:, away[:, line] < 0.3]
        assert found.any(axis=1).mean() > 0.9
        middle = view.y_m[away[:, line] < 0.3][np.nonzero(found)[1]].mean()
        assert abs(middle - OFFSETS[line]) < 0.06


@pytest.mark.parametrize("name", ready_networks())
def test_the_layout_of_each_ready_network_fits_its_file(tmp_path: Path, name: str) -> None:
    network = read_network(written(tmp_path, name))
    text = describe_onnx(Path(network.model))
    (line,) = (line for line in text.splitlines() if line.startswith(f"layout {network.layout} "))
    assert name in line


def test_an_onnx_is_shown_or_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.onnx"
    outputs = {"a": np.zeros((1, 7, 2)), "b": np.zeros((1, 7, 8)), "c": np.zeros((1, 9))}
    write_known(file, outputs, (320, 160), {"mask": (1, 1)})
    assert command("show", file).stdout == (
        "takes picture: 1 x 3 x 160 x 320\ntakes mask: 1 x 1\n"
        "gives a: 1 x 7 x 2\ngives b: 1 x 7 x 8\ngives c: 1 x 9\n"
        "layout lstr_curves fits, as for the ready networks lstr\n"
    )
    file.write_bytes(b"nothing")
    assert refused("show", file).startswith(
        f"network: {file}: is not an ONNX file that can be read"
    )
    absent = tmp_path / "absent.onnx"
    assert refused("show", absent) == f"network: {absent}: No such file or directory"


@pytest.mark.parametrize(
    ("shapes", "layouts"),
    [
        ([(1, 2, 40, 80), (1, 4, 40, 80)], ["lanes", "instances"]),
        ([(1, 999, 4), (1, 999, 1), (1, 3, 40, 80)], ["lanes", "instances"]),
        ([(1, 39, 99), (1, 32, 40, 40)], ["prototypes", "lanes", "instances"]),
        ([(1, 101, 56, 4)], ["row_anchors"]),
        ([(1, 3), (2, 2)], []),
        # Channels last.
        ([(1, 40, 80, 20)], []),
    ],
)
def test_the_layouts_that_fit_another_file_are_listed(
    tmp_path: Path, shapes: list[tuple[int, ...]], layouts: list[str]
) -> None:
    outputs = {f"out{k}": np.zeros(shape) for k, shape in enumerate(shapes)}
    text = describe_onnx(write_known(tmp_path / "mine.onnx", outputs, (80, 40)))
    assert [line.split()[1] for line in text.splitlines() if "fits, as" in line] == layouts
    assert ("no layout fits" in text) == (not layouts)


@pytest.mark.parametrize(
    "shape", [(1, 40, 80, 3), (None, None, None, 3), (1, 1, 40, 80), (3, 40, 80)]
)
def test_no_layout_fits_if_no_input_is_a_picture_with_its_colours_first(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    file = write_known(tmp_path / "mine.onnx", {"mask": np.zeros((1, 2, 40, 80))}, (80, 40))
    model = onnx.load(str(file))
    port = onnx.helper.make_tensor_value_info("picture", onnx.TensorProto.FLOAT, shape)
    model.graph.input[0].CopyFrom(port)
    onnx.save(model, str(file))
    *_, last = describe_onnx(file).splitlines()
    assert last.startswith("no layout fits: the network takes no pictures of 1 x 3 x height x")


def test_the_page_has_each_layout_each_key_and_each_network() -> None:
    assert set(ready_networks()) == set(GIVES)
    for word in (*OUTPUTS, *Network.model_fields, *GIVES):
        assert f"`{word}`" in PAGE
