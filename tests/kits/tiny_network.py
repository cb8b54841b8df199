"""Lane networks as ONNX files: narrow bright strips, or what a test puts in."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

#: How wide the strips are that the filters look for, pixels of the input.
_STRIPS = (1, 3, 7)
_REACH = 13


def _filters(side: int) -> NDArray[np.float32]:
    """(S, 1, 1, 2 R + 1): the mean of a strip of a row, less that of its left (-1) or right (1)
    side."""
    place = np.arange(-_REACH, _REACH + 1)
    found = []
    for wide in _STRIPS:
        middle = np.abs(place) <= wide // 2
        beside = (place * side > wide // 2 + 1) & (place * side <= wide // 2 + 5)
        found.append(middle / middle.sum() - beside / beside.sum())
    return 4 * np.array(found, dtype=np.float32)[:, None, None, :]


def write_top_hat(folder: Path, width: int, height: int) -> Path:
    """A network without training, for pictures of this size: narrow bright strips are lanes. Gives
    its YAML."""
    from onnx import helper

    wide = {"kernel_shape": [1, 2 * _REACH + 1], "pads": [0, _REACH, 0, _REACH]}
    nodes = [
        helper.make_node("Conv", ["picture", "grey"], ["level"], kernel_shape=[1, 1]),
        helper.make_node("Conv", ["level", "lefts"], ["left"], **wide),
        helper.make_node("Conv", ["level", "rights"], ["right"], **wide),
        helper.make_node("Min", ["left", "right"], ["strip"]),
        helper.make_node("ReduceMax", ["strip"], ["best"], axes=[1], keepdims=1),
        helper.make_node("Sub", ["best", "least"], ["lanes"]),
    ]
    weights = [
        ("grey", np.full((1, 3, 1, 1), 1 / 3, dtype=np.float32)),
        ("lefts", _filters(-1)),
        ("rights", _filters(1)),
        ("least", np.float32(0.6)),
    ]
    shape = (1, 3, height, width)
    outputs = {"lanes": (1, 1, height, width)}
    write_onnx(folder / "top_hat.onnx", nodes, weights, outputs, {"picture": shape})
    keys = {"size": [width, height], "layout": "lanes", "classes": 1, "activation": "sigmoid"}
    return write_network(folder / "top_hat.yaml", model="top_hat.onnx", **keys)


@functools.cache
def top_hat_file(width: int, height: int) -> Path:
    """The YAML of a top-hat network, in a folder that is there until the tests end."""
    folder = Path(tempfile.mkdtemp(prefix="egolane-top-hat-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return write_top_hat(folder, width, height)


def write_answer(folder: Path, output: NDArray[np.float32], **keys: Any) -> Path:
    """A network that gives this output whatever the picture, for inputs of 80 x 40 pixels, and its
    YAML with these keys."""
    return write_answers(folder, {"answer": output}, **keys)


def write_answers(folder: Path, outputs: dict[str, NDArray[Any]], **keys: Any) -> Path:
    """The same with several outputs."""
    keys = {"model": "known.onnx", "size": [80, 40], **keys}
    write_known(folder / keys["model"], outputs, keys["size"])
    return write_network(folder / "known.yaml", **keys)


def write_known(
    path: Path,
    outputs: dict[str, NDArray[Any]],
    size: tuple[int, int],
    others: dict[str, tuple[int, ...]] | None = None,
) -> Path:
    """A network that gives these outputs whatever the picture, for inputs of this width and
    height, and other inputs of these shapes."""
    from onnx import helper

    nodes = [
        helper.make_node("ReduceMean", ["picture"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        *(helper.make_node("Add", [f"known {name}", "nothing"], [name]) for name in outputs),
    ]
    known = [(f"known {name}", output.astype(np.float32)) for name, output in outputs.items()]
    ports = {name: output.shape for name, output in outputs.items()}
    weights = [("zero", np.float32(0)), *known]
    inputs = {"picture": (1, 3, size[1], size[0]), **(others or {})}
    return write_onnx(path, nodes, weights, ports, inputs)


# --- files ----------------------------------------------------------------------------------------


def write_network(path: Path, **keys: Any) -> Path:
    """The YAML of a network."""
    path.write_text(yaml.safe_dump(keys))
    return path


def write_onnx(
    path: Path,
    nodes: Sequence[Any],
    weights: Sequence[tuple[str, Any]],
    outputs: dict[str, tuple[int, ...]],
    inputs: dict[str, tuple[Any, ...]],
) -> Path:
    """An ONNX file of some nodes."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    def ports(shapes: dict[str, tuple[Any, ...]]) -> list[Any]:
        return [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
            for name, shape in shapes.items()
        ]

    graph = helper.make_graph(
        list(nodes),
        "tiny",
        ports(inputs),
        ports(outputs),
        [numpy_helper.from_array(np.asarray(value), name) for name, value in weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path
