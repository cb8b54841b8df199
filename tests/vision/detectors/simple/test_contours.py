"""Contours of marking, in shapes whose area, middle and direction are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from egolane_pgm.vision.detectors.simple.birdseye import make_view
from egolane_pgm.vision.detectors.simple.contours import Strips, find_strips
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA

#: Pixels of 0.1 m along the road and 0.05 m across it.
VIEW = make_view(CAMERA, 5.0, 30.0, -5.0, 5.0, 0.1, 0.05)

pytestmark = needs_compiler


def nothing() -> NDArray[np.uint8]:
    return np.zeros(VIEW.valid.shape, dtype=np.uint8)


def strips_of(mask: NDArray[np.uint8]) -> Strips:
    return find_strips(VIEW, mask)


def test_a_bar_along_the_road_is_measured_in_metres() -> None:
    mask = nothing()
    mask[100:120, 60:64] = 1  # 2 m long, 0.2 m wide
    strips = strips_of(mask)
    assert strips.row.tolist() == list(range(100, 120))
    np.testing.assert_allclose(strips.x_m, VIEW.x_m[100:120])
    np.testing.assert_allclose(strips.y_m, VIEW.y_m[60:64].mean())
    np.testing.assert_allclose(strips.width_m, 0.2)
    assert strips.contour.tolist() == [0] * 20
    assert strips.middle_m == pytest.approx([VIEW.x_m[100:120].mean()])
    assert strips.slope == pytest.approx([0.0], abs=1e-12)
    # A bar tells its direction as well as it is long for its width.
    assert strips.slope_sd == pytest.approx([0.2 / 2.0])


@pytest.mark.parametrize("to_the_right", [1, -1])
def test_a_bar_across_its_row_has_the_direction_of_its_middles(to_the_right: int) -> None:
    mask = nothing()
    for row in range(100, 140):
        # Rows run from far to near: a column to the right every four rows is to the left ahead.
        left = 100 + to_the_right * ((row - 100) // 4)
        mask[row, left : left + 4] = 1
    strips = strips_of(mask)
    assert strips.slope == pytest.approx([-to_the_right * 0.05 / 0.4], rel=0.02)
    # The same as of a bar that is not turned: 0.2 m wide, 4 m long.
    assert strips.slope_sd == pytest.approx([0.2 / 4.0], rel=0.05)


def test_contours_that_are_small_or_across_the_road_are_dropped_and_the_rest_renumbered() -> None:
    mask = nothing()
    mask[230:232, 20:23] = 1  # 0.03 m^2
    for row in range(100, 110):
        mask[row, 3 * row - 240 : 3 * row - 237] = 1  # 1.5 m to the left per metre ahead
    mask[150:180, 60:64] = 1
    mask[200:220, 60:64] = 1
    strips = strips_of(mask)
    assert sorted(set(strips.row.tolist())) == [*range(150, 180), *range(200, 220)]
    assert len(strips.middle_m) == len(strips.slope) == len(strips.slope_sd) == 2
    # The numbers are those of the contours that are left.
    np.testing.assert_allclose(
        strips.middle_m[strips.contour],
        np.where(strips.row < 200, VIEW.x_m[150:180].mean(), VIEW.x_m[200:220].mean()),
    )


def test_both_sides_of_a_hole_are_one_contour() -> None:
    mask = nothing()
    mask[100:160, 60:72] = 1
    mask[110:150, 64:68] = 0
    strips = strips_of(mask)
    assert len(strips.row) == 20 + 2 * 40
    assert set(strips.contour.tolist()) == {0}
    assert strips.middle_m == pytest.approx([VIEW.x_m[100:160].mean()])
    assert strips.slope == pytest.approx([0.0], abs=1e-12)
    # What is inside of the hole is a contour of its own.
    mask[115:145, 65:67] = 1
    strips = strips_of(mask)
    assert len(strips.middle_m) == 2
    inner = (strips.y_m > VIEW.y_m[64]) & (strips.y_m < VIEW.y_m[67]) & (strips.width_m < 0.11)
    assert len(set(strips.contour[inner].tolist())) == 1
    assert set(strips.contour[~inner].tolist()).isdisjoint(strips.contour[inner].tolist())
