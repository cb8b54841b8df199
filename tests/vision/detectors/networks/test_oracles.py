"""Each layout of several outputs, on random ones, against the arithmetic that the network's authors
published, written again in plain loops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.networks.finding import looker
from egolane_pgm.vision.detectors.networks.layouts import Line
from tests.kits.synthetic_road import CAMERA, road
from tests.kits.tiny_network import write_answers

WIDTH, HEIGHT = 480, 270
seeds = pytest.mark.parametrize("seed", range(2))

#: Pixels are counted from their middles here, from their edges in the published code.
HALF_PX = 0.5


def lines_of(path: Path) -> list[Line]:
    assert (CAMERA.width, CAMERA.height) == (WIDTH, HEIGHT)
    found = looker(read_network(path), CAMERA)(Picture(0, road()))
    assert isinstance(found, list)
    return found


def sigmoid(x: FloatArray) -> FloatArray:
    return 1 / (1 + np.exp(-x))


def softmax(x: FloatArray) -> FloatArray:
    return np.exp(x) / np.exp(x).sum(axis=-1, keepdims=True)


def check(lines: list[Line], wanted: list[Any], less: float = HALF_PX) -> None:
    """Lines in pixels of the picture, in the same order."""
    assert len(lines) == len(wanted)
    for line, points in zip(lines, wanted, strict=True):
        np.testing.assert_allclose(line.points, np.array(points) - less, atol=1e-3)


# --- anchors ----------------------------------------------------------------------------------


@seeds
@pytest.mark.parametrize(
    ("rows", "cut_top", "n_rows"), [("tusimple", 0.2, 56), ("culane", 0.4, 72)]
)
def test_four_outputs_are_read_as_ultra_fast_lane_detection_2_does(
    tmp_path: Path, seed: int, rows: str, cut_top: float, n_rows: int
) -> None:
    """`pred2coords` of demo.py, before it drops the fractions."""
    rng = np.random.default_rng(seed)
    outputs = {
        "loc_row": rng.normal(0, 3, (1, 100, n_rows, 4)),
        "loc_col": rng.normal(0, 3, (1, 90, 41, 4)),
        "exist_row": rng.normal(0, 1, (1, 2, n_rows, 4)),
        "exist_col": rng.normal(-0.5, 1, (1, 2, 41, 4)) * [1, 1, 1, -1],
    }
    outputs = {name: values.astype(np.float32).astype(float) for name, values in outputs.items()}
    first, last = {"tusimple": (160 / 720, 710 / 720), "culane": (0.42, 1)}[rows]
    row_anchor, col_anchor = np.linspace(first, last, n_rows), np.linspace(0, 1, 41)
    wanted = []
    for axis, lanes, least in (("row", (1, 2), 2), ("col", (0, 3), 4)):
        loc, exist = outputs[f"loc_{axis}"][0], outputs[f"exist_{axis}"][0].argmax(axis=0)
        for lane in lanes:
            if exist[:, lane].sum() <= exist.shape[0] / least:
                continue
            points = []
            for k in np.flatnonzero(exist[:, lane]):
                best = int(loc[:, k, lane].argmax())
                cells = np.arange(max(0, best - 1), min(len(loc) - 1, best + 1) + 1)
                at = ((softmax(loc[cells, k, lane]) * cells).sum() + 0.5) / (len(loc) - 1)
                if axis == "row":
                    points.append((at * WIDTH, row_anchor[k] * HEIGHT))
                else:
                    points.append((col_anchor[k] * WIDTH, at * HEIGHT))
            wanted.append(points)
    keys = {"layout": "hybrid_anchors", "rows": rows, "cut_top": cut_top}
    found = lines_of(write_answers(tmp_path, outputs, **keys))
    check(found, wanted)
    assert all(0.5 < line.probability < 1 for line in found)


# --- curves -----------------------------------------------------------------------------------


@seeds
def test_lstr(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores, curves = rng.normal(0, 2, (1, 7, 2)), rng.uniform(0.1, 0.9, (1, 7, 8))
    curves[..., 3] = -0.2
    wanted, likely = [], []
    for (no, yes), (lower, upper, k, f, m, n, b, c) in zip(scores[0], curves[0], strict=True):
        if yes > no:
            y = np.linspace(lower, upper, 100)
            x = k / (y - f) ** 2 + m / (y - f) + n + b * y - c
            wanted.append(np.stack([x * WIDTH, y * HEIGHT], axis=1))
            likely.append(softmax(np.array([no, yes]))[1])
    names = {"scores": "pred_logits", "curves": "pred_curves"}
    outputs = {"pred_logits": scores, "pred_curves": curves, "weights": np.zeros((1, 3, 3))}
    found = lines_of(write_answers(tmp_path, outputs, layout="lstr_curves", output=names))
    check(found, wanted)
    np.testing.assert_allclose([line.probability for line in found], likely, rtol=1e-5)


# --- segments ---------------------------------------------------------------------------------


def row_middles(mask: FloatArray) -> dict[int, float]:
    """The middle of each row of the picture of a mask of the input, 80 x 40."""
    whole = cv2.resize(mask, (WIDTH, HEIGHT)) > 0.5
    return {v: float(np.flatnonzero(row).mean()) for v, row in enumerate(whole) if row.any()}


def drawn_masks(rng: np.random.Generator) -> FloatArray:
    """Four strips across the input, (4, 40, 80), as logits."""
    masks = np.full((4, 40, 80), -8.0)
    for k, (first, slope) in enumerate(
        zip((8, 26, 44, 62), rng.uniform(-0.2, 0.2, 4), strict=True)
    ):
        for row in range(10, 36):
            middle = first + slope * row
            masks[k, row] = 8 * np.clip(3 - np.abs(np.arange(80) - middle), -1, 1)
    return masks


def check_middles(lines: list[Line], masks: list[FloatArray]) -> None:
    assert len(lines) == len(masks)
    for line, mask in zip(lines, masks, strict=True):
        middles = row_middles(mask)
        inside = [(u, v) for u, v in line.points if round(v) in middles and 65 < v < 235]
        assert len(inside) > 15
        # Pixels of the input are six of the picture's wide.
        for u, v in inside:
            assert abs(u - middles[round(v)]) < 4


@seeds
def test_yolo_with_prototypes(tmp_path: Path, seed: int) -> None:
    """`process_mask` and the suppression of Ultralytics: sigmoid of coefficients times prototypes
    inside the box; of boxes of one class, the best. Class 0 is no line, 1 is dashed, 2 solid."""
    rng = np.random.default_rng(seed)
    common = drawn_masks(rng)
    boxes = np.zeros((60, 4 + 3 + 4))
    boxes[:, :4] = rng.uniform(10, 30, (60, 4))
    for k, kind in enumerate((1, 2, 0, 2)):
        x, score = (8, 26, 44, 62)[k], 0.9 - 0.1 * k
        boxes[10 * k, :4] = (x, 22, 20, 30)
        # A worse one of the same line.
        boxes[10 * k + 3, :4] = (x + 0.5, 22, 20, 30)
        for row, less in ((10 * k, 0.0), (10 * k + 3, 0.2)):
            boxes[row, 4 + kind] = score - less
            boxes[row, 7 + k] = 1
    keys: dict[str, Any] = {"layout": "prototypes", "threshold": 0.25}
    keys |= {"output": {"boxes": "output0", "prototypes": "output1"}}
    outputs = {"output0": boxes.T[None], "output1": common[None]}
    every = lines_of(write_answers(tmp_path, outputs, **keys))
    assert [line.kind for line in every] == [1, 2, 0, 2]
    classes = {"dashed": [1], "solid": [2]}
    found = lines_of(write_answers(tmp_path, outputs, classes=classes, **keys))
    assert [line.kind for line in found] == [1, 2, 2]
    np.testing.assert_allclose([line.probability for line in found], [0.9, 0.8, 0.6], rtol=1e-6)
    masks = [sigmoid(common[k]) for k in (0, 1, 3)]
    columns = np.arange(80)
    for mask, x in zip(masks, (8, 26, 62), strict=True):
        mask[:, (columns < x - 10) | (columns >= x + 10)] = 0
        mask[:7] = mask[37:] = 0
    check_middles(found, masks)
