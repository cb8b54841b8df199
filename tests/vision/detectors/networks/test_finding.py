"""A network as a detector over a drive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.detectors.runner import detect, find_detector
from tests.kits.synthetic_road import CAMERA, drive
from tests.kits.tiny_network import write_answers


def write_segments(folder: Path, lines: Sequence[tuple[float, int, float]], **keys: Any) -> Path:
    """A network that sees straight lines, each with its offset, class and probability."""
    size, n = (CAMERA.width, CAMERA.height), len(lines)
    masks, boxes = np.full((1, n, *size[::-1]), -9.0), np.zeros((1, 4 + 4 + n, 20))
    far = np.linspace(3, 60, 2000)
    for k, (offset, kind, likely) in enumerate(lines):
        u, v = (np.round(at).astype(int) for at in road_to_image(CAMERA, far, offset))
        inside = (u >= 1) & (u < size[0] - 1) & (v >= 0) & (v < size[1])
        for aside in (-1, 0, 1):
            masks[0, k, v[inside], u[inside] + aside] = 9
        left, right = u[inside].min() - 2, u[inside].max() + 2
        boxes[0, :4, k] = ((left + right) / 2, size[1] / 2, right - left, size[1])
        boxes[0, 4 + kind, k] = likely
        boxes[0, 8 + k, k] = 1
    outputs = {"boxes": boxes, "prototypes": masks}
    return write_answers(folder, outputs, layout="prototypes", size=list(size), **keys)


def test_classes_are_the_continuous_flag_and_probabilities_the_lri(tmp_path: Path) -> None:
    """Three lines of a network with classes, on pictures in which two others are painted; another
    class is no line."""
    kinds = ((-3.4, 1, 0.9), (0.3, 2, 0.6), (3.9, 2, 1.0), (7.5, 3, 0.95), (-7, 1, 0.3))
    path = write_segments(tmp_path, kinds, classes={"dashed": [1], "solid": [2]})
    given = {"network": str(path), "beyond_edge": "keep"}
    detector = find_detector("network", given, "detector")
    *_, (_, lines) = detect(detector, CAMERA, drive(12))
    np.testing.assert_allclose(lines.offset_m, [-3.4, 0.3, 3.9], atol=0.05)
    assert lines.is_continuous.tolist() == [False, True, True]
    np.testing.assert_allclose(lines.lri, [9, 6, 10], rtol=1e-5)
    assert lines.is_valid.all()
