"""What each layout says of a picture, by outputs whose answer is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.networks.finding import looker
from egolane_pgm.vision.detectors.networks.layouts import Answer
from tests.kits.synthetic_road import CAMERA, road
from tests.kits.tiny_network import write_answer


def seen(path: Path) -> Answer:
    """What the network sees in a picture of the camera, 480 x 270 pixels."""
    found = looker(read_network(path), CAMERA)(Picture(0, road()))
    assert found is not None
    return found


def logit(share: np.ndarray) -> np.ndarray:
    return np.log(share / (1 - share))


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
