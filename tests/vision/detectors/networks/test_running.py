"""Pictures go through a network as its YAML says, OpenCV computes what onnxruntime does, and what
does not fit is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import helper

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.networks.description import Network, read_network
from egolane_pgm.vision.detectors.networks.running import Outputs, as_input, fit_of, load, read_onnx
from tests.kits.tiny_network import (
    write_answer,
    write_answers,
    write_network,
    write_onnx,
    write_top_hat,
)


def noise(width: int, height: int) -> Image:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def started(path: Path, width: int = 160, height: int = 120) -> Callable[[Image], Outputs]:
    network = read_network(path)
    return load(network, fit_of(network, width, height))


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        started(path)(noise(160, 120))
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    return message


# --- what goes in and comes out ---------------------------------------------------------------


def test_colours_are_scaled_in_the_order_of_the_network() -> None:
    image = np.zeros((20, 40, 3), dtype=np.uint8)
    image[:] = (10, 20, 30)
    keys: dict[str, Any] = {"model": "x.onnx", "size": (40, 20), "layout": "lanes", "classes": 1}
    keys |= {"mean": (1, 2, 3), "scale": (1, 10, 100)}
    for swap, wanted in ((True, (29, 180, 700)), (False, (9, 180, 2700))):
        network = Network(**keys, swap_rb=swap)
        values = as_input(network, fit_of(network, 40, 20), image)
        assert values.shape == (1, 3, 20, 40)
        assert values[0, :, 7, 7].tolist() == list(wanted)


def test_the_top_is_cut_off_and_bars_keep_the_proportions() -> None:
    image = np.full((100, 200, 3), 50, dtype=np.uint8)
    image[:20] = 255
    network = Network(
        model="x.onnx", size=(64, 64), layout="lanes", classes=1, scale=1, cut_top=0.2, letterbox=7
    )
    fit = fit_of(network, 200, 100)
    # 200 x 80 pixels are left, made 64 x 26.
    assert (fit.top, fit.left, fit.upper, fit.wide, fit.high) == (20, 0, 19, 64, 26)
    values = as_input(network, fit, image)[0, 0]
    assert (values[:19] == 7).all()
    assert (values[19:45] == 50).all()
    assert (values[45:] == 7).all()
    u, v = fit.to_picture(np.array([-0.5, 63.5]), np.array([18.5, 44.5]))
    np.testing.assert_allclose(u, [-0.5, 199.5])
    np.testing.assert_allclose(v, [19.5, 99.5])


# --- bad input --------------------------------------------------------------------------------


def test_a_file_that_is_not_onnx_is_named(tmp_path: Path) -> None:
    keys = {"model": "x.onnx", "size": [80, 40], "layout": "lanes", "classes": 2}
    path = write_network(tmp_path / "net.yaml", **keys)
    whole = tmp_path / "known.onnx"
    write_answer(tmp_path, np.zeros((1, 2, 4, 8)), layout="lanes", classes=2)
    contents = [b"", b"no network at all, " * 30, bytes(range(256)), whole.read_bytes()[:-40]]
    for content in contents:
        (tmp_path / "x.onnx").write_bytes(content)
        assert "x.onnx: is not an ONNX file" in refused(path)


def test_an_operation_that_opencv_does_not_know_is_refused(tmp_path: Path) -> None:
    node = helper.make_node("Telepathy", ["picture"], ["answer"], domain="elsewhere")
    graph = helper.make_graph(
        [node],
        "odd",
        [helper.make_tensor_value_info("picture", 1, (1, 3, 40, 80))],
        [helper.make_tensor_value_info("answer", 1, (1, 2, 40, 80))],
    )
    sets = [helper.make_opsetid("", 13), helper.make_opsetid("elsewhere", 1)]
    onnx.save(helper.make_model(graph, opset_imports=sets), str(tmp_path / "odd.onnx"))
    keys = {"model": "odd.onnx", "size": [80, 40], "layout": "lanes", "classes": 2}
    message = refused(write_network(tmp_path / "net.yaml", **keys))
    assert f"OpenCV {cv2.__version__} cannot" in message


def conv(tmp_path: Path, shape: tuple[Any, ...], **keys: Any) -> Path:
    """A network of one convolution with two outputs, `area` and `marks`."""
    colours = shape[1] if isinstance(shape[1], int) else 3
    weight = np.ones((2, colours, 1, 1), dtype=np.float32)
    nodes = [
        helper.make_node("Conv", ["picture", "w"], ["area"], kernel_shape=[1, 1]),
        helper.make_node("Relu", ["area"], ["marks"]),
    ]
    out = (1, 2, *shape[2:])
    write_onnx(
        tmp_path / "x.onnx",
        nodes,
        [("w", weight)],
        {"area": out, "marks": out},
        {"picture": shape},
    )
    keys = {"size": [80, 40], "layout": "lanes", "classes": 2, "output": "area", **keys}
    return write_network(tmp_path / "net.yaml", model="x.onnx", **keys)


def test_other_inputs_than_a_picture_of_that_size_are_refused(tmp_path: Path) -> None:
    assert started(conv(tmp_path, (1, 3, 40, 80)))(noise(160, 120))["mask"].shape == (2, 40, 80)
    assert started(conv(tmp_path, ("n", 3, "h", "w")))(noise(160, 120))["mask"].shape == (2, 40, 80)
    message = refused(conv(tmp_path, (1, 3, 40, 80), size=[80, 48]))
    assert (
        "the network takes 1 x 3 x 40 x 80 (picture), but size [80, 48] makes 1 x 3 x 48 x 80"
        in message
    )
    assert "takes 1 x 1 x 40 x 80" in refused(conv(tmp_path, (1, 1, 40, 80)))
    write_onnx(
        tmp_path / "x.onnx",
        [helper.make_node("Add", ["picture", "before"], ["area"])],
        [],
        {"area": (1, 3, 40, 80)},
        {"picture": (1, 3, 40, 80), "before": (1, 3, 40, 80)},
    )
    message = refused(tmp_path / "net.yaml")
    assert "the network takes picture, before; give the constant of each but the picture" in message
    assert message.endswith("inputs: {before: 0}")


@pytest.mark.parametrize(
    ("shapes", "keys", "message"),
    [
        ({"answer": (1, 3, 4, 8)}, {"layout": "lanes", "classes": 2},
         "answer 1 x 3 x 4 x 8; layout lanes needs mask 1 x k x h x w, k = 2 (docs/networks.md)"),
        ({"answer": (1, 2, 4)}, {"layout": "lanes", "classes": 2}, "answer 1 x 2 x 4; layout"),
        ({"answer": (1, 2, 4, 8)}, {"layout": "lanes", "classes": 2, "channels": [2]}, "k = 2"),
        ({"answer": (1, 11, 5, 2)}, {"layout": "row_anchors", "classes": 11, "rows": "culane"},
         "needs columns 1 x k x r x n, k = 11, r = 18"),
        ({"answer": (1, 4, 6)}, {"layout": "polylines", "length": 4},
         "answer 1 x 4 x 6; layout polylines needs candidates 1 x n x k"),
        ({"loc_row": (1, 9, 5, 4), "loc_col": (1, 9, 6, 4), "exist_row": (1, 2, 6, 4),
          "exist_col": (1, 2, 6, 4)}, {"layout": "hybrid_anchors", "rows": "culane"},
         "exist_row 1 x 2 x 6 x 4, exist_col"),
        ({"boxes": (1, 8, 99), "prototypes": (1, 8, 5, 5)}, {"layout": "prototypes"},
         "boxes 1 x 8 x 99, prototypes 1 x 8 x 5 x 5; layout prototypes needs"),
        ({"scores": (1, 9, 2)}, {"layout": "lstr_curves"},
         "output: no output 'curves'"),
    ],
)  # fmt: skip
def test_outputs_that_do_not_fit_the_yaml_are_refused(
    tmp_path: Path, shapes: dict[str, tuple[int, ...]], keys: dict[str, Any], message: str
) -> None:
    outputs = {name: np.zeros(shape) for name, shape in shapes.items()}
    assert message in refused(write_answers(tmp_path, outputs, **keys))


def test_an_output_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    output = np.zeros((1, 2, 4, 8))
    output[0, 1, 2, 3:6] = np.nan
    message = refused(write_answer(tmp_path, output, layout="lanes", classes=2))
    assert message.endswith("output answer: has numbers that are not finite (NaN)")


# --- the ONNX file ----------------------------------------------------------------------------


def test_opencv_computes_the_outputs_of_onnxruntime(tmp_path: Path) -> None:
    network = read_network(write_top_hat(tmp_path, 160, 120))
    fit, image = fit_of(network, 160, 120), noise(160, 120)
    session = onnxruntime.InferenceSession(network.model)
    (wanted,) = session.run(["lanes"], {"picture": as_input(network, fit, image)})
    np.testing.assert_allclose(load(network, fit)(image)["mask"], wanted[0], rtol=1e-4, atol=1e-4)
    assert read_onnx(Path(network.model), "here").inputs == {"picture": (1, 3, 120, 160)}
