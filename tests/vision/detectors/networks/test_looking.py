"""A network over a drive: as a detector of its own, and as what tells others where the road is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.detectors.runner import detect, find_detector, start
from tests.kits.synthetic_road import CAMERA, drive
from tests.kits.tiny_network import (
    write_answer,
    write_answers,
    write_top_hat,
)


@pytest.fixture(scope="module")
def top_hat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_top_hat(tmp_path_factory.mktemp("top_hat"), CAMERA.width, CAMERA.height)


def write_segments(folder: Path, lines: Sequence[tuple[float, int, float]], **keys: Any) -> Path:
    """A network that sees straight lines, each with its offset, class and probability."""
    size, n = (CAMERA.width, CAMERA.height), len(lines)
    masks, boxes = np.full((1, n, *size[::-1]), -9.0), np.zeros((1, n, 6 + n))
    far = np.linspace(3, 60, 2000)
    for k, (offset, kind, likely) in enumerate(lines):
        u, v = (np.round(at).astype(int) for at in road_to_image(CAMERA, far, offset))
        inside = (u >= 1) & (u < size[0] - 1) & (v >= 0) & (v < size[1])
        for aside in (-1, 0, 1):
            masks[0, k, v[inside], u[inside] + aside] = 9
        boxes[0, k, :6] = (0, 0, *size, likely, kind)
        boxes[0, k, 6 + k] = 1
    outputs = {"boxes": boxes, "prototypes": masks}
    return write_answers(folder, outputs, layout="prototypes", size=list(size), **keys)


def lines_of(name: str, given: dict[str, Any], pictures: list[Picture]) -> list[FrameLines]:
    detector = find_detector(name, given, Path.cwd(), "detector")
    return [lines for _, lines in detect(detector, CAMERA, pictures)]


# --- a detector of its own --------------------------------------------------------------------


def test_classes_are_the_continuous_flag_and_probabilities_the_lri(tmp_path: Path) -> None:
    """Three lines of a network with classes, on pictures in which two others are painted; another
    class is no line."""
    kinds = ((-3.4, 1, 0.9), (0.3, 2, 0.6), (3.9, 2, 1.0), (7.5, 3, 0.95), (-7, 1, 0.3))
    path = write_segments(tmp_path, kinds, classes={"dashed": [1], "solid": [2]})
    given = {"network": str(path), "beyond_edge": "keep"}
    lines = lines_of("network", given, drive(12))[-1]
    np.testing.assert_allclose(lines.offset_m, [-3.4, 0.3, 3.9], atol=0.05)
    assert lines.is_continuous.tolist() == [False, True, True]
    np.testing.assert_allclose(lines.lri, [9, 6, 10], rtol=1e-5)
    assert lines.is_valid.all()


def test_a_network_without_lines_is_no_detector(tmp_path: Path) -> None:
    path = write_answer(tmp_path, np.ones((1, 1, 4, 8)), layout="drivable", classes=1)
    detector = find_detector("network", {"network": str(path)}, Path.cwd(), "detector")
    with pytest.raises(InputError, match="layout drivable has no lines; name it as on_road,"):
        start(detector, CAMERA)


# --- where the road is ------------------------------------------------------------------------


def test_beside_lines_there_is_a_margin(top_hat: Path) -> None:
    """Nothing is lost where the network sees the lines, all is where it sees none."""
    pictures = drive(12)
    alone = lines_of("ml", {}, pictures)[-1]
    helped = lines_of("ml", {"on_road": str(top_hat)}, pictures)[-1]
    np.testing.assert_allclose(helped.offset_m, alone.offset_m, atol=0.03)
    assert (helped.is_continuous == alone.is_continuous).all()
