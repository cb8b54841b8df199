"""Each step of the calibration from parallel lines, on numbers made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.calibration.road_lines import (
    FrameFit,
    RoadView,
    doubts_of,
    view_from,
)
from egolane_pgm.vision.camera.model import Camera
from tests.kits.calibration_kit import TRUE, lines_of, unturned, view_of_lines

PLAIN = replace(unturned(TRUE), distortion=(0.0,) * 5, lateral_m=0.25, lane_width_m=3.6)


def view_of(
    slopes: list[list[float]],
    each: Any = ((0.0, 0.0), (0.0, 0.0)),
    ahead: tuple[float, float] = (0.0, 0.0),
    camera: Camera = PLAIN,
) -> RoadView:
    fits = [FrameFit(np.array(ahead), np.array(s)) for s in slopes]
    return view_from(camera, np.array(ahead), np.array(each, dtype=float), fits)


def test_the_height_is_the_lane_width_over_the_gap_of_slopes() -> None:
    view = view_of([[-4.0, -1.5, 1.0], [-1.0, 1.5]])
    assert view.camera.height_m == pytest.approx(3.6 / 2.5)
    assert view.camera.lateral_m == 0.25
    np.testing.assert_allclose(view.gaps_m, 3.6)
    assert view.is_lane.all()
    assert view.spread_px.tolist() == [0.0, 0.0]
    # Gaps far to the side tell it less.
    near, far = 2.5, 2.7
    height = view_of([[-1.25, -1.25 + near], [7.0, 7.0 + far]]).camera.height_m
    assert height == pytest.approx(3.6 / near)
    # Neither two stripes of one marking nor what is lanes apart.
    odd = view_of([[-1.25, -1.05, 1.25], [-1.25, 1.25, 9.0]])
    np.testing.assert_allclose(sorted(odd.gaps_m), [2.3 / 2.5 * 3.6, 3.6], rtol=0.06)


@pytest.mark.parametrize(
    ("spread", "is_refused"),
    [((0.16, 0.0), True), ((0.14, 0.0), False), ((0.0, 0.055), True), ((0.0, 0.045), False)],
)
def test_points_that_scatter_sideways_or_up_and_down_are_no_vanishing_point(
    spread: tuple[float, float], is_refused: bool
) -> None:
    each = np.array([[k * spread[0], k * spread[1]] for k in (-1, 1)] * 8)
    if is_refused:
        with pytest.raises(InputError, match=r"the lines of 16 frames meet at .* do not meet"):
            view_of([[-1.0, 1.5]], each)
    else:
        found = view_of([[-1.0, 1.5]], each).spread_px
        np.testing.assert_allclose(found, np.array(spread) * (PLAIN.fx, PLAIN.fy))


@pytest.mark.parametrize(
    ("height", "width", "message"),
    [
        (1.4, 3.6, ""),
        (2.8, 3.6, ""),
        (1.4, 2.1, "two lanes were taken"),
        (2.1, 5.9, "half a lane was taken"),
        # The heights are possible: only the widths are strange.
        (1.4, 4.6, "2.5 to 4.5 m wide almost everywhere, not 4.6 m"),
        (1.4, 5.9, "2.5 to 4.5 m wide almost everywhere, not 5.9 m"),
    ],
)
def test_a_height_of_no_car_and_a_width_of_no_lane_are_doubted(
    height: float, width: float, message: str
) -> None:
    """The lanes are 3.6 m wide."""
    true = replace(PLAIN, height_m=height, pitch_deg=-2.0)
    view = view_of_lines(true, PLAIN, [lines_of(true, (-5.4, -1.8, 1.8, 5.4))] * 3, width)
    assert view.camera.lane_width_m == width
    doubt = doubts_of(view)
    assert bool(doubt) == bool(message)
    assert message in doubt
