"""The frame of a video: the picture with its lines, the bird's-eye view, and the bars of the
belief."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.vision import video
from egolane_pgm.vision.camera.model import image_to_road, road_to_image
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.video import bar_boxes, draw_frame, label_boxes, layout
from tests.kits.drawn_frames import (
    CAMERA,
    LINES,
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
    assert places.picture == (640, 400)
    assert places.birdseye == (200, 400)
    assert image.shape[0] >= 400 + 150
    # The sky is as it was, the paper below is white.
    assert is_colour(image[5, 5], (90, 90, 90), 0)
    assert is_colour(image[-2, 2], (255, 255, 255), 0)


def test_a_lens_does_not_fold_the_road_back_into_the_picture() -> None:
    bent = replace(CAMERA, distortion=(-0.25, -0.02, 0.0, 0.0, 0.0))
    image = draw_frame(layout(bent), road(bent), scene([1, 0], 1))
    u, v = road_to_image(bent, 8.0, OFFSETS[0])
    assert any(is_colour(p, video.CONTINUOUS, 40) for p in around(image, float(u), float(v)))
    assert (image[:130, :640] == 90).all(), "there is nothing above the horizon"


def test_small_pictures_are_drawn_larger_and_odd_ones_are_made_even() -> None:
    small = replace(CAMERA, width=321, height=101, cx=160, cy=20)
    places = layout(small)
    assert places.picture[1] == 360
    assert places.size[0] % 2 == places.size[1] % 2 == 0
    image = draw_frame(places, road(small), scene([1, 0], 1))
    assert image.shape == (places.size[1], places.size[0], 3)


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


def test_lines_that_are_behind_or_far_beside_the_camera_do_no_harm() -> None:
    wild = FrameLines(
        np.array([[-500.0, -50.0, 3.0, 9.0], [0.0, 0.0, 0.0, 0.0], [1e9, 1e9, 0.0, 0.0]]),
        *(np.ones(3, dtype=bool),) * 2,
        np.ones(3),
    )
    assert drawn(scene([1, 0], 1, lines=wild)).shape == drawn(scene([1, 0], 1)).shape
    up = replace(CAMERA, pitch_deg=50)
    assert draw_frame(layout(up), road(up), scene([1, 0], 1)).dtype == np.uint8


def some_lines(offsets: Sequence[float], heading: float = 0.0) -> FrameLines:
    shape = np.array([[offset, heading, 0.0, 0.0] for offset in sorted(offsets)]).reshape(-1, 4)
    yes = np.ones(len(shape), dtype=bool)
    return FrameLines(shape, yes, yes, np.full(len(shape), 10.0))


@given(
    st.lists(st.floats(-25, 25), max_size=14),
    st.floats(-0.15, 0.15),
    st.sampled_from([(640, 400), (64, 40), (1280, 720), (270, 480)]),
)
def test_labels_are_below_the_picture_side_by_side_and_in_the_frame(
    offsets: list[float], heading: float, size: tuple[int, int]
) -> None:
    camera = replace(CAMERA, width=size[0], height=size[1], cx=size[0] / 2, cy=size[1] / 2)
    places = layout(camera)
    lines = some_lines(offsets, heading)
    boxes = label_boxes(places, lines)
    assert list(boxes) == sorted(boxes)
    for left, top, right, bottom in boxes.values():
        assert 0 <= left < right <= places.picture[0]
        assert places.picture[1] <= top < bottom <= places.panel[0]
    for one, other in pairwise(boxes.values()):
        assert one[2] <= other[0]
    draw_frame(places, road(camera), scene([1, 0], 1, lines=lines))


def test_a_label_is_at_the_foot_of_its_line_in_its_colour() -> None:
    """-1.9 m and 1.6 m leave the picture below, 5.2 m at the side; 200 m is not in it."""
    image = drawn(scene([1, 0], 1))
    boxes = label_boxes(layout(CAMERA), LINES)
    for k, colour in enumerate((video.CONTINUOUS, video.DASHED, video.NOT_VALID)):
        left, top, right, _ = boxes[k]
        bar = image[top + 1, left : right - 1]
        assert all(is_colour(pixel, colour, 3) for pixel in bar)
        if k != 2:
            _, y = image_to_road(CAMERA, (left + right) / 2, 399.0)
            assert float(y) == pytest.approx(OFFSETS[k], abs=0.15)
        else:  # it leaves the picture at the side
            assert right == 640
    assert list(label_boxes(layout(CAMERA), some_lines([1.6, 200.0]))) == [0]


def test_nothing_is_written_on_the_picture_or_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    many = some_lines([-9.5, -9.0, -5.4, -1.9, 1.6, 5.2, 9.5])
    whole = drawn(scene([1, 0], 1, lines=many))
    monkeypatch.setattr(video, "_write", lambda *given: None)
    silent = drawn(scene([1, 0], 1, lines=many))
    np.testing.assert_array_equal(whole[:400, :840], silent[:400, :840])
    assert (whole[:400, 840:] != silent[:400, 840:]).any()


def in_slots(offsets: Sequence[float], slots: Sequence[int]) -> FrameLines:
    return replace(some_lines(offsets), slot=np.array(slots))


def far_apart(colours: Sequence[tuple[int, int, int]]) -> float:
    """The least difference of two colours as people see it who cannot tell red from green: red and
    green become one."""
    seen = [(blue, (green + red) / 2) for blue, green, red in colours]
    return min(np.hypot(a[0] - b[0], a[1] - b[1]) for a, b in combinations(seen, 2))


def test_slots_have_colours_that_stay_with_their_lines() -> None:
    assert len(set(video.SLOTS)) == 6
    assert video.TRUTH not in video.SLOTS
    assert far_apart(video.SLOTS) > 25
    for offsets, slots in (((-1.9, 1.6, 5.2), [2, 0, 5]), ((-5.5, -1.9, 1.6), [4, 2, 0])):
        lines = in_slots(offsets, slots)
        image = drawn(scene([1, 0], 1, lines=lines))
        for slot, (left, top, right, _) in zip(
            slots, label_boxes(layout(CAMERA), lines).values(), strict=True
        ):
            bar = image[top + 1, (left + right) // 2]
            assert is_colour(bar, video.SLOTS[slot], 3)
    # There are six colours; a seventh line has the first again.
    lines = in_slots([1.6], [6])
    image, boxes = drawn(scene([1, 0], 1, lines=lines)), label_boxes(layout(CAMERA), lines)
    assert is_colour(image[boxes[0][1] + 1, boxes[0][0] + 5], video.SLOTS[0], 3)


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
    assert filled(image, boxes[2], video.INK) == 1
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
    plain = drawn(scene([0, 1, 0], 2, truth=1))
    assert (plain != drawn(scene([0, 1, 0], 2, truth=1, is_crossing=True))).any()


@pytest.mark.parametrize("truth", [1, 8])
def test_the_mark_of_the_truth_is_as_large_as_other_text_and_in_the_frame(truth: int) -> None:
    image = drawn(scene([1 / 8] * 8, 0, truth=truth, is_crossing=True))
    lower = bar_boxes(layout(CAMERA), 8)[0][3]
    seen = np.abs(image[lower + 18 :].astype(int) - video.TRUTH).max(axis=2) < 60
    columns = np.flatnonzero(seen.any(axis=0))
    assert columns[-1] - columns[0] > 80  # the bars are 60 wide
    assert columns[-1] < 640


def test_eight_lanes_fit() -> None:
    boxes = bar_boxes(layout(CAMERA), 8)
    assert len(boxes) == 9
    assert boxes[-1][2] <= 640
    drawn(scene([1 / 8] * 8, 0, truth=8))
