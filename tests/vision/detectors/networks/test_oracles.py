"""Each layout of several outputs, on random ones, against the arithmetic that the network's authors
published, written again in plain loops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
