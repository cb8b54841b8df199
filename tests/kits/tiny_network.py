"""A small lane network, trained on rendered pictures: fixed filters, a random hidden layer and a
last layer by logistic regression, as an ONNX file with two outputs, `lanes` and `drivable`. Also
networks of one layer that give what a test puts in."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from egolane_pgm.vision.camera.model import image_to_road
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.rendering.render import FrameTruth, line_y, render_frame
from egolane_pgm.vision.rendering.scene import Failures, Scene, make_scene

#: Width and height of the network's input.
SIZE = (656, 272)

#: How wide the strips are that the filters look for, pixels of the input.
_STRIPS = (1, 3, 7)
_REACH = 13
_HIDDEN = 64

#: Traffic everywhere and worn paint, always.
HEAVY = Failures(occlusion=1, wear=0.9, shadow=0, pitch=0.3, noise=0.3, glare=0, calm=1, bad_s=0)


def heavy_traffic(seed: int, frames: int = 600) -> Scene:
    """A drive among many vehicles."""
    return make_scene("a4", seed=seed, frames=frames, failures=HEAVY)


# --- training -------------------------------------------------------------------------------------


def labels(scene: Scene, truth: FrameTruth, image: Image) -> NDArray[np.bool_]:
    """Where a frame shows marking, free road, and vehicles, in pixels of the input: (3, h, w)."""
    hidden = vehicles(scene, truth.frame_id, image)
    is_free = cv2.resize(hidden, SIZE, interpolation=cv2.INTER_AREA) < 40
    camera = truth.camera
    u = (np.arange(SIZE[0]) + 0.5) * camera.width / SIZE[0] - 0.5
    v = (np.arange(SIZE[1]) + 0.5) * camera.height / SIZE[1] - 0.5
    x, y = image_to_road(camera, u, v[:, None])
    is_road = np.isfinite(x) & (x > 0) & (x < 100)
    x = np.where(is_road, x, 100.0)
    grid = np.linspace(0, 100, 401)
    lines = [np.interp(x, grid, line) for line in line_y(scene, truth.frame_id, grid)]
    pixel_m = x * camera.width / SIZE[0] / camera.fx
    is_paint = np.zeros(x.shape, dtype=bool)
    for k, line in enumerate(lines):
        near = np.abs(y - line) <= np.maximum(scene.lines.width_m[k], pixel_m) / 2
        is_paint |= near & scene.lines.is_dash(k, scene.s_m[truth.frame_id] + x)
    is_between = (y > lines[0] - 0.3) & (y < lines[-1] + 0.3)
    return np.stack([is_paint & is_road & is_free, is_between & is_road & is_free, ~is_free])


def vehicles(scene: Scene, k: int, image: Image) -> Image:
    """255 where frame k shows a vehicle, (H, W): what its picture without vehicles has not."""
    none = replace(scene.traffic, **_empty(scene))
    free = render_frame(replace(scene, traffic=none), k).image
    differs = np.abs(image.astype(np.int16) - free).max(axis=2) > 12
    return np.where(differs, 255, 0).astype(np.uint8)


def _empty(scene: Scene) -> dict[str, Any]:
    few = {}
    for name, value in vars(scene.traffic).items():
        if isinstance(value, np.ndarray) and len(value) == len(scene.traffic):
            few[name] = value[:0]
    return few


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
    """Trains on some frames of one drive; writes tiny.onnx, lanes.yaml and drivable.yaml."""
    import onnxruntime
    from onnx import helper

    rng = np.random.default_rng(seed)
    nodes, weights = _body(rng)
    write_onnx(folder / "hidden.onnx", nodes, weights, {"hidden": (1, _HIDDEN, *SIZE[::-1])})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(folder / "hidden.onnx"), options)
    scene = heavy_traffic(seed)
    seen, marked = [], []
    for k in np.linspace(0, len(scene) - 1, n_frames).astype(int):
        frame = render_frame(scene, int(k))
        picture = cv2.resize(frame.image, SIZE, interpolation=cv2.INTER_LINEAR)[..., ::-1]
        values = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        hidden = session.run(["hidden"], {"picture": values})[0][0].reshape(_HIDDEN, -1)
        label = labels(scene, frame.truth, frame.image).reshape(3, -1)
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
