"""The frame of a video: the picture with its lines, the bird's-eye view, and the bars of the
belief."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from egolane_pgm.vision import video
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.video import bar_boxes, draw_frame, layout
from tests.kits.drawn_frames import (
    CAMERA,
    OFFSETS,
    around,
    drawn,
    filled,
    is_colour,
    road,
    scene,
)


def test_a_frame_has_the_picture_the_birds_eye_view_and_a_panel() -> None:
    places = layout(CAMERA)
    image = drawn(scene([1, 0], 1))
    assert image.shape == (places.size[1], places.size[0], 3)
    assert places.size[0] % 2 == places.size[1] % 2 == 0
    assert (places.camera.width, places.camera.height) == (640, 400)
    assert places.from_above[0].shape == (400, 200)
    assert image.shape[0] >= 400 + 150
    # The sky is as it was, the paper below is white.
    assert is_colour(image[5, 5], (90, 90, 90), 0)
    assert is_colour(image[-2, 2], (255, 255, 255), 0)


@pytest.mark.parametrize("ahead", [6.5, 7.5, 13.0])
def test_lines_are_drawn_where_they_are_in_the_colours_of_the_legend(ahead: float) -> None:
    image = drawn(scene([1, 0], 1))
    colours = (video.CONTINUOUS, video.DASHED, video.NOT_VALID)
    for offset, colour in zip(OFFSETS, colours, strict=True):
        u, v = road_to_image(CAMERA, ahead, offset)
        if u < 630 and v < 390:
            assert any(is_colour(p, colour, 40) for p in around(image, float(u), float(v)))


def test_only_a_continuous_line_has_no_gaps() -> None:
    image = drawn(scene([1, 0], 1))
    for offset, colour in ((OFFSETS[0], video.CONTINUOUS), (OFFSETS[1], video.DASHED)):
        for ahead, is_dash in ((7.5, True), (10.5, False), (13.5, True)):
            u, v = road_to_image(CAMERA, ahead, offset)
            is_drawn = any(is_colour(p, colour, 60) for p in around(image, float(u), float(v)))
            assert is_drawn == (is_dash or colour == video.CONTINUOUS)


def test_the_birds_eye_view_shows_lines_and_road_to_scale() -> None:
    places = layout(CAMERA)
    picture = road()
    # A white cross-stroke on the road, 20 m ahead, from 3 m left to 3 m right.
    u, v = road_to_image(CAMERA, 20.0, np.array([-3.0, 3.0]))
    ends = [(round(a), round(b)) for a, b in zip(u.tolist(), v.tolist(), strict=True)]
    cv2.line(picture, ends[0], ends[1], (255, 255, 255), 2)
    none = FrameLines(np.zeros((0, 4)), *(np.zeros(0, dtype=bool),) * 2, np.zeros(0))
    image = draw_frame(places, picture, scene([1, 0], 1, lines=none))
    view = image[:400, 640:840]
    row = round(400 * (40 - 20) / 40)
    bright = np.flatnonzero(view[row - 6 : row + 7].max(axis=(0, 2)) > 180)
    metres = (bright[[0, -1]] + 0.5) * 20 / 200 - 10
    np.testing.assert_allclose(metres, [-3, 3], atol=0.5)
    view = drawn(scene([1, 0], 1))[:400, 640:840]
    column = round((OFFSETS[0] + 10) * 200 / 20)
    assert any(is_colour(p, video.CONTINUOUS, 40) for p in around(view, column, 250))


def test_bars_show_the_belief_over_the_lanes_from_left_to_right() -> None:
    belief = [0.1, 0.6, 0.25, 0.05]
    image = drawn(scene(belief, 2))
    boxes = bar_boxes(layout(CAMERA), 4)
    lefts = [box[0] for box in boxes]
    assert lefts == sorted(lefts)
    assert all(a[2] < b[0] for a, b in pairwise(boxes))
    for k, share in enumerate(belief):
        colour = video.ASSIGNED if k == 1 else video.OTHER
        assert filled(image, boxes[k], colour) == pytest.approx(share, abs=0.04)
    # The last one is for no answer, and empty here.
    assert filled(image, boxes[4], (255, 255, 255)) == 1


def test_unassigned_is_shown_and_no_lane_is_marked() -> None:
    image = drawn(scene([0.5, 0.5], 0))
    boxes = bar_boxes(layout(CAMERA), 2)
    assert filled(image, boxes[2], video.FRAME) == 1
    for box in boxes[:2]:
        assert filled(image, box, video.OTHER) == pytest.approx(0.5, abs=0.05)
        assert filled(image, box, video.ASSIGNED) == 0


def test_the_true_lane_is_outlined_where_it_is_known() -> None:
    boxes = bar_boxes(layout(CAMERA), 3)
    for truth in (None, 1, 3):
        image = drawn(scene([0, 1, 0], 2, truth=truth))
        for k, (left, upper, _, lower) in enumerate(boxes[:3]):
            outline = image[(upper + lower) // 2, left - 3]
            assert is_colour(outline, video.TRUTH, 3) == (truth == k + 1)
