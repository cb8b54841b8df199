"""A small lane network, trained on drawn pictures: fixed filters, a random hidden layer and a
last layer by logistic regression, as an ONNX file with two outputs, `lanes` and `drivable`. Also
networks of one layer that give what a test puts in."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.simulated import DASH_M, PERIOD_M, Paint, draw_road
from tests.kits.vehicles import car, lorry, with_vehicles

#: Width and height of the network's input.
SIZE = (656, 272)

#: How wide the strips are that the filters look for, pixels of the input.
_STRIPS = (1, 3, 7)
_REACH = 13
_HIDDEN = 64

CAMERA = Camera(1312, 540, 760.0, 760.0, 655.5, 215.0, 1.5, pitch_deg=-1.0)


@dataclass(frozen=True)
class Shown:
    """A picture of a road among vehicles. is_vehicle: (H, W)."""

    image: Image
    lines: tuple[Paint, ...]
    travelled_m: float
    is_vehicle: NDArray[np.bool_]


def heavy_traffic(seed: int, k: int) -> Shown:
    """A frame among many vehicles, on a road of four lanes whose paint is worn."""
    rng = np.random.default_rng([seed, k])
    own = int(rng.integers(4))
    edges = (np.arange(5) - own - 0.5) * 3.75 + rng.uniform(-1, 1)
    worn = rng.uniform(140, 200)
    lines = [Paint(place, DASH_M, PERIOD_M, width_m=0.2, grey=worn) for place in edges]
    lines[0], lines[-1] = (replace(lines[k], dash_m=1.0, period_m=1.0) for k in (0, -1))
    vehicles = []
    for lane in range(4):
        middle = edges[lane] + 1.875 + rng.normal(0, 0.15)
        nearest = 14.0 if lane == own else 4.0
        kind = lorry if rng.random() < 0.3 else car
        vehicles.append(kind(rng.uniform(nearest, 45), middle))
    travelled_m = 2.7 * k
    road = draw_road(lines, travelled_m, camera=CAMERA, seed=k)
    image, is_vehicle = with_vehicles(road, CAMERA, vehicles)
    return Shown(image, tuple(lines), travelled_m, is_vehicle)


# --- training -------------------------------------------------------------------------------------


def labels(shown: Shown) -> NDArray[np.bool_]:
    """Where a frame shows marking, free road, and vehicles, in pixels of the input: (3, h, w)."""
    hidden = shown.is_vehicle.astype(np.uint8) * 255
    is_free = cv2.resize(hidden, SIZE, interpolation=cv2.INTER_AREA) < 40
    u = (np.arange(SIZE[0]) + 0.5) * CAMERA.width / SIZE[0] - 0.5
    v = (np.arange(SIZE[1]) + 0.5) * CAMERA.height / SIZE[1] - 0.5
    x, y = image_to_road(CAMERA, u, v[:, None])
    is_road = np.isfinite(x) & (x > 0) & (x < 80)
    x = np.where(is_road, x, 80.0)
    pixel_m = x * CAMERA.width / SIZE[0] / CAMERA.fx
    is_paint = np.zeros(x.shape, dtype=bool)
    for line in shown.lines:
        near = np.abs(y - line.offset_m) <= np.maximum(line.width_m, pixel_m) / 2
        is_paint |= near & (np.mod(x + shown.travelled_m, line.period_m) < line.dash_m)
    first, last = shown.lines[0].offset_m, shown.lines[-1].offset_m
    is_between = (y > first - 0.3) & (y < last + 0.3)
    return np.stack([is_paint & is_road & is_free, is_between & is_road & is_free, ~is_free])


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


def _body(rng: np.random.Generator) -> tuple[list[Any], list[tuple[str, Any]]]:
    """The fixed layers up to the hidden one: nodes and weights."""
    from onnx import helper

    width, height = SIZE
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    weights: list[tuple[str, Any]] = [
        ("grey", np.full((1, 3, 1, 1), 1 / 3, dtype=np.float32)),
        ("lefts", _filters(-1)),
        ("rights", _filters(1)),
        ("place", np.stack([v, v * v, u, u * u])[None]),
    ]
    n_features = 3 + 3 + 3 + len(_STRIPS) + 4
    mixing = rng.normal(0, 1.5, (_HIDDEN, n_features, 1, 1)).astype(np.float32)
    weights += [("mixing", mixing), ("bias", rng.normal(0, 1, _HIDDEN).astype(np.float32))]

    def pool(given: str, name: str, size: tuple[int, int]) -> Any:
        pads = [size[0] // 2, size[1] // 2] * 2
        return helper.make_node("AveragePool", [given], [name], kernel_shape=list(size), pads=pads)

    one = {"kernel_shape": [1, 1]}
    wide = {"kernel_shape": [1, 2 * _REACH + 1], "pads": [0, _REACH, 0, _REACH]}
    parts = ["picture", "near", "around", "strip", "place"]
    nodes = [
        pool("picture", "near", (5, 5)),
        pool("near", "high", (25, 1)),
        pool("high", "around", (1, 25)),
        helper.make_node("Conv", ["picture", "grey"], ["level"], **one),
        helper.make_node("Conv", ["level", "lefts"], ["left"], **wide),
        helper.make_node("Conv", ["level", "rights"], ["right"], **wide),
        helper.make_node("Min", ["left", "right"], ["strip"]),
        helper.make_node("Concat", parts, ["features"], axis=1),
        helper.make_node("Conv", ["features", "mixing", "bias"], ["mixed"], **one),
        helper.make_node("Relu", ["mixed"], ["hidden"]),
    ]
    return nodes, weights


def _fit(hidden: NDArray[np.float64], is_one: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The weights (1 + F,) of a logistic regression, by Newton's method."""
    design = np.column_stack([np.ones(len(hidden)), hidden])
    found = np.zeros(design.shape[1])
    for _ in range(8):
        likely = 1 / (1 + np.exp(-np.clip(design @ found, -30, 30)))
        slope = design.T @ (is_one - likely) - 1e-2 * found
        bend = (design * (likely * (1 - likely))[:, None]).T @ design
        found += np.linalg.solve(bend + 1e-2 * np.eye(len(found)), slope)
    return found


def write_trained(folder: Path, seed: int = 3, n_frames: int = 12) -> Path:
    """Trains on some pictures; writes tiny.onnx, lanes.yaml and drivable.yaml."""
    import onnxruntime
    from onnx import helper

    rng = np.random.default_rng(seed)
    nodes, weights = _body(rng)
    write_onnx(folder / "hidden.onnx", nodes, weights, {"hidden": (1, _HIDDEN, *SIZE[::-1])})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(folder / "hidden.onnx"), options)
    seen, marked = [], []
    for k in range(n_frames):
        shown = heavy_traffic(seed, k)
        picture = cv2.resize(shown.image, SIZE, interpolation=cv2.INTER_LINEAR)[..., ::-1]
        values = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        hidden = session.run(["hidden"], {"picture": values})[0][0].reshape(_HIDDEN, -1)
        label = labels(shown).reshape(3, -1)
        # All of the little marking, much of vehicles, and some of the rest.
        rare = [np.flatnonzero(label[0]), np.flatnonzero(label[2])[::20]]
        pick = np.concatenate([*rare, rng.choice(label.shape[1], 4000, replace=False)])
        seen.append(hidden[:, pick].T.astype(np.float64))
        marked.append(label[:, pick])
    for k, name in enumerate(("lanes", "drivable")):
        found = _fit(np.concatenate(seen), np.concatenate(marked, axis=1)[k])
        last = np.zeros((2, _HIDDEN, 1, 1), dtype=np.float32)
        last[1, :, 0, 0] = found[1:]
        weights += [(f"{name}_w", last), (f"{name}_b", np.array([0, found[0]], dtype=np.float32))]
        inputs = ["hidden", f"{name}_w", f"{name}_b"]
        nodes.append(helper.make_node("Conv", inputs, [name], kernel_shape=[1, 1]))
    (folder / "hidden.onnx").unlink()
    shape = (1, 2, *SIZE[::-1])
    write_onnx(folder / "tiny.onnx", nodes, weights, {"lanes": shape, "drivable": shape})
    for name in ("lanes", "drivable"):
        write_network(
            folder / f"{name}.yaml",
            model="tiny.onnx",
            size=list(SIZE),
            output=name,
            layout=name,
            classes=2,
            activation="softmax",
        )
    return folder


# --- untrained ------------------------------------------------------------------------------------


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
    inputs: dict[str, tuple[Any, ...]] | None = None,
    opset: int = 13,
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
        ports(inputs or {"picture": (1, 3, SIZE[1], SIZE[0])}),
        ports(outputs),
        [numpy_helper.from_array(np.asarray(value), name) for name, value in weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path
