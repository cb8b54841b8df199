"""What each layout says of a picture, by outputs whose answer is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import image_to_road, road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.networks.finding import looker
from egolane_pgm.vision.detectors.networks.layouts import Answer, Line
from tests.kits.synthetic_road import CAMERA, road
from tests.kits.tiny_network import write_answer, write_answers

#: Offsets of the lines that the outputs show, metres.
OFFSETS = (-2.9, 0.1, 3.1)
#: The rows of the input that show all of them, 5 to 13 m ahead.
ROWS = np.arange(21, 32)


def seen(path: Path) -> Answer:
    """What the network sees in a picture of the camera, 480 x 270 pixels."""
    found = looker(read_network(path), CAMERA)(Picture(0, road()))
    assert found is not None
    return found


def columns() -> np.ndarray:
    """Where the lines are in the rows of an input of 80 x 40 pixels: (lines, rows)."""
    far = np.geomspace(2, 300, 3000)[::-1]
    found = []
    for offset in OFFSETS:
        u, v = road_to_image(CAMERA, far, offset)
        v_in, u_in = (v + 0.5) * 40 / 270 - 0.5, (u + 0.5) * 80 / 480 - 0.5
        found.append(np.interp(ROWS, v_in, u_in))
    return np.array(found)


def logit(share: np.ndarray) -> np.ndarray:
    return np.log(share / (1 - share))


def check_offsets(lines: Sequence[Line], places: Sequence[float] = OFFSETS) -> None:
    """The lines are where they should be, within the width of a pixel of the input."""
    assert len(lines) == len(places)
    for line, place in zip(lines, places, strict=True):
        x, y = image_to_road(CAMERA, *line.points.T)
        near = (x > 6) & (x < 11)
        assert near.any()
        assert np.abs(y[near] - place).max() < 0.15


@pytest.mark.parametrize("activation", ["none", "sigmoid", "softmax"])
def test_a_mask_is_where_the_probability_of_its_channels_is_enough(
    tmp_path: Path, activation: str
) -> None:
    share = np.full((4, 8), 0.2)
    share[2:, 4:] = 0.7
    output = np.stack([1 - share, share / 2, share / 2])
    if activation == "sigmoid":
        output = logit(output)
    if activation == "softmax":
        output = np.log(output) + 3
    keys: dict[str, Any] = {"layout": "drivable", "classes": 3, "activation": activation}
    both = seen(write_answer(tmp_path, output[None], **keys))
    assert both.mask is not None
    assert both.mask.shape == (270, 480)
    assert (both.mask[170:, 290:] == 255).all()
    assert (both.mask[:110] == 0).all()
    assert (both.mask[:, :200] == 0).all()
    one = seen(write_answer(tmp_path, output[None], channels=[1], **keys))
    assert one.mask is not None
    assert not one.mask.any()
    low = seen(write_answer(tmp_path, output[None], channels=[1], threshold=0.3, **keys))
    assert low.mask is not None
    assert (low.mask[170:, 290:] == 255).all()


@pytest.mark.parametrize("size", [(40, 80), (4, 8)])
def test_lines_are_part_of_the_road(tmp_path: Path, size: tuple[int, int]) -> None:
    """The free road leaves the paint out; one with more classes is refused."""
    road, lanes = np.zeros((1, 2, *size)), np.zeros((1, 2, 4, 8))
    road[0, 1, :, : size[1] // 2] = lanes[0, 1, :, 6:] = 1
    outputs = {"da": road, "ll": lanes}
    keys: dict[str, Any] = {"layout": "drivable", "classes": 2}
    for output, place in (("da", [1, 0, 0]), ({"mask": "da", "lanes": "ll"}, [1, 0, 1])):
        found = seen(write_answers(tmp_path, outputs, output=output, **keys))
        assert found.mask is not None
        assert (found.mask[:, [100, 300, 450]] == np.array(place) * 255).all()
    outputs["ll"] = lanes[:, :1]
    with pytest.raises(InputError, match="layout drivable needs"):
        seen(write_answers(tmp_path, outputs, output={"mask": "da", "lanes": "ll"}, **keys))


def test_instances_are_lines_through_the_middle_of_their_channels(tmp_path: Path) -> None:
    output = np.full((1, 4, 40, 80), 0.01)
    for k, line in enumerate(columns()):
        away = np.abs(np.arange(80) - line[:, None])
        output[0, 1 + k, ROWS] = np.maximum(0.99 - away / 5, 0.01)
    keys: dict[str, Any] = {"layout": "instances", "classes": 4, "threshold": 0.3}
    found = seen(write_answer(tmp_path, output, **keys))
    assert found.mask is None
    assert len(found.lines) == 3
    check_offsets(found.lines)
    for line, share in zip(found.lines, output[0, 1:], strict=True):
        assert line.probability == pytest.approx(share[share >= 0.3].mean(), abs=1e-6)
    two = seen(write_answer(tmp_path, output, channels=[1, 3], **keys))
    check_offsets(two.lines, (OFFSETS[0], OFFSETS[2]))


def test_row_anchors_are_read_as_ultra_fast_lane_detection_writes_them(tmp_path: Path) -> None:
    """100 columns; the second line is absent in the upper half, a fourth one is absent."""
    cells = 100
    output = np.zeros((1, cells + 1, len(ROWS), 4))
    for k, line in enumerate(columns()):
        cell = line * (cells - 1) / 79 - 0.5
        away = np.abs(np.arange(cells) - cell[:, None])
        output[0, :cells, :, k] = 12 - away.T**2
    output[0, cells, :, :3] = 11
    output[0, cells, :, 3] = 20
    output[0, cells, :5, 1] = 20
    keys: dict[str, Any] = {"layout": "row_anchors", "classes": cells + 1, "rows": ROWS.tolist()}
    found = seen(write_answer(tmp_path, output, **keys))
    assert [len(line.points) for line in found.lines] == [11, 6, 11]
    share = np.exp(output[0]) / np.exp(output[0]).sum(axis=0)
    likely = [share[:cells, first:, k].sum(axis=0).mean() for k, first in enumerate((0, 5, 0))]
    np.testing.assert_allclose([line.probability for line in found.lines], likely, rtol=1e-5)
    assert min(likely) < 0.99
    check_offsets(found.lines[::2], (OFFSETS[0], OFFSETS[2]))
    # Each point where it was put, in pixels of the picture.
    wanted = (columns()[1, 5:] + 0.5) * 6 - 0.5
    np.testing.assert_allclose(found.lines[1].points[:, 0], wanted, atol=0.5)
    np.testing.assert_allclose(found.lines[1].points[:, 1], (ROWS[5:] + 0.5) * 6.75 - 0.5)


@pytest.mark.parametrize("in_pixels", [False, True])
def test_polylines_are_read_as_clrnet_and_laneatt_write_them(
    tmp_path: Path, in_pixels: bool
) -> None:
    """40 rows from the bottom up. Two candidates of one line, one unlikely one."""
    rows = np.arange(39, -1, -1)
    output = np.zeros((1, 5, 6 + 40))
    for k, line in enumerate(columns()[[0, 1, 1, 2, 2]]):
        x = np.interp(rows, ROWS, line)
        length = len(ROWS) if in_pixels else len(ROWS) / 39
        output[0, k] = [0, 3, 8 / 39, 0, 0, length, *(x if in_pixels else x / 79)]
    output[0, 4, :2] = (3, 0)
    # The first line starts four rows higher.
    output[0, 0, 2] = 12 / 39
    output[0, 0, 5] -= 4 if in_pixels else 4 / 39
    keys: dict[str, Any] = {"layout": "polylines", "start": 2, "length": 5, "first_x": 6}
    found = seen(write_answer(tmp_path, output, in_pixels=in_pixels, **keys))
    assert [len(line.points) for line in found.lines] == [7, 11, 11, 11]
    assert found.lines[0].points[0, 1] == pytest.approx((27 + 0.5) * 6.75 - 0.5)
    check_offsets(found.lines[1:], (OFFSETS[1], OFFSETS[1], OFFSETS[2]))
