"""Marking pixels in views from above, on grey levels made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.detectors.simple.birdseye import make_view
from egolane_pgm.vision.detectors.simple.markings import marking_mask
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from tests.kits.synthetic_road import CAMERA

_PART = make_view(CAMERA, 5.0, 30.0, -5.0, 5.0, 0.1, 0.05)

#: 250 rows of 0.1 m, 200 columns of 0.05 m, all of them in the picture.
VIEW = replace(_PART, valid=np.ones_like(_PART.valid))


def grey(value: int = 100) -> NDArray[np.uint8]:
    return np.full(VIEW.valid.shape, value, dtype=np.uint8)


def mask_of(above: NDArray[np.uint8], view: object = VIEW, **given: object) -> NDArray[np.bool_]:
    parameters = resolve_parameters(FINDING, given, 1)
    return marking_mask(view, above, parameters) > 0  # type: ignore[arg-type]


def columns(mask: NDArray[np.bool_]) -> list[int]:
    """The columns that are marking in every row; no other may be in any row."""
    assert (mask.all(axis=0) == mask.any(axis=0)).all()
    return np.flatnonzero(mask.all(axis=0)).tolist()


@pytest.mark.parametrize("width", [1, 3, 4])
def test_a_narrow_strip_is_marking_and_nothing_beside_it(width: int) -> None:
    above = grey()
    above[:, 90 : 90 + width] = 130
    assert columns(mask_of(above)) == list(range(90, 90 + width))


def test_a_strip_wider_than_a_marking_is_not_one() -> None:
    above = grey()
    above[:, 90:97] = 130  # 0.35 m
    assert not mask_of(above).any()
    assert columns(mask_of(above, marking_width_m=0.45)) == list(range(90, 97))
    assert not mask_of(above, marking_width_m=0.35).any()
    dark = grey()
    dark[:, 90:93] = 60
    assert not mask_of(dark).any()


def test_a_marking_adds_its_share_of_the_brightness_around() -> None:
    # 1 of 100 + 40 is less than 1.25 %, 4 are more.
    for rise, is_marking in ((1, False), (4, True)):
        above = grey()
        above[:, 90:93] += rise
        assert mask_of(above).any() == is_marking
    shade = grey(20)
    shade[:, 90:93] += 2
    assert columns(mask_of(shade)) == [90, 91, 92]


def test_a_strip_as_rough_as_its_surroundings_is_not_a_marking() -> None:
    above = grey()
    above[:, 90:93] = 110
    assert columns(mask_of(above)) == [90, 91, 92]
    # Rough from 1.2 m beside the strip on: within the patch of 4 m.
    above[:, 117:200:2] = 140
    assert not mask_of(above)[:, 90:93].any()
    assert mask_of(above, least_rise=0.5)[:, 90:93].all()


def test_road_between_hidden_parts_is_not_a_marking() -> None:
    valid = VIEW.valid.copy()
    valid[:, 90:92] = valid[:, 95:97] = False
    above = grey()
    above[~valid] = 0
    assert not mask_of(above, replace(VIEW, valid=valid)).any()
    # Nor is a strip right beside the rim.
    half = VIEW.valid.copy()
    half[:, :90] = False
    above = np.where(half, grey(), 0).astype(np.uint8)
    above[:, 92:94] = 140
    assert not mask_of(above, replace(VIEW, valid=half)).any()
    above[:, 110:112] = 140
    assert columns(mask_of(above, replace(VIEW, valid=half))) == [110, 111]
