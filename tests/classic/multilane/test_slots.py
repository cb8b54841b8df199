"""The tracker on lines whose markings are given, and MLD as a whole on drawn drives: each line
keeps its slot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from egolane_pgm.classic import mld
from egolane_pgm.classic.multilane import curves
from egolane_pgm.classic.multilane.road import flattened, road_of, shapes_of
from egolane_pgm.classic.multilane.slots import (
    BOOTSTRAP,
    FRAMES,
    Slots,
    advance,
    no_slots,
)
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines
from tests.conftest import needs_compiler
from tests.kits.synthetic_road import CAMERA as SMALL
from tests.kits.synthetic_road import Paint, drive

CAMERA = Camera(1280, 720, 1065.0, 1065.0, 639.5, 359.5, height_m=1.65, pitch_deg=-6.6)
ROAD = road_of(CAMERA, 55.0, 0.078, 0.3)
LANE_M = 3.6

#: How far the car moves sideways in a frame of a brisk lane change, metres.
STEP_M = 0.12

DEFAULTS = resolve_parameters(mld.PARAMETERS, {}, 1)


def points(offset: float) -> tuple[FloatArray, FloatArray]:
    """The markings of a continuous line: t and column."""
    x = np.geomspace(4, 54, 300)
    u, v = road_to_image(CAMERA, x, np.full_like(x, offset))
    inside = (v < ROAD.bottom) & (u >= 0) & (u < CAMERA.width)
    return flattened(ROAD, v[inside], u[inside])


def seen(slots: Slots, lines: Sequence[float], most: int = 4) -> Slots:
    """One more frame, in which the lines at these offsets are seen."""
    each = [points(offset) for offset in lines]
    found = [curves.fit(t, u, 1) for t, u in each if len(t) > 60]
    nothing = np.zeros(0), np.zeros(0)
    t, u = (np.concatenate(axis) for axis in zip(nothing, *each, strict=True))
    given = np.array(found).reshape(-1, 3)
    return advance(slots, ROAD, t, u, given, most, np.random.default_rng(0))


def offsets(slots: Slots) -> dict[int, float]:
    """By slot the offset of its line, metres."""
    used = np.flatnonzero(slots.is_used)
    shape = shapes_of(ROAD, slots.curve[used])
    return dict(zip(used.tolist(), shape[:, 0].tolist(), strict=True))


def settled(lines: Sequence[float], most: int = 4) -> Slots:
    """After so many frames that every line is followed and counted in full."""
    slots = no_slots()
    for _ in range(BOOTSTRAP + FRAMES):
        slots = seen(slots, lines, most)
    return slots


def test_lines_take_their_places_left_and_right_of_the_car() -> None:
    lines = [-5.1, -1.5, 2.1, 5.7]
    slots = settled(lines)
    where = offsets(slots)
    for place, true in zip((-1, 0, 1, 2), lines, strict=True):
        assert where[slots.at(place)] == pytest.approx(true, abs=0.05)
    assert slots.counter[slots.is_used].tolist() == [FRAMES] * 4
    two = settled(lines, most=2)
    assert sorted(offsets(two)) == sorted(two.at(k) for k in (0, 1))


@pytest.mark.parametrize("side", [-1, 1])
def test_a_lane_change_turns_the_ring_by_one_and_lines_keep_their_slots(side: int) -> None:
    lines = LANE_M * (np.arange(-3, 4) - 0.5)
    start = slots = settled(lines.tolist())
    line_of: dict[int, int] = {}
    turns = 0
    for k in range(1, round(LANE_M / STEP_M) + FRAMES):
        moved = side * min(k * STEP_M, LANE_M)
        after = seen(slots, (lines - moved).tolist())
        turns += after.left != slots.left
        slots = after
        now = {}
        for slot, offset in offsets(slots).items():
            if slots.counter[slot] > mld.SHOWN_ABOVE:
                now[slot] = round((offset + moved) / LANE_M - 0.5)
                assert offset + moved == pytest.approx(LANE_M * (now[slot] + 0.5), abs=0.2)
        # A slot that has become free may have taken a new line, which is not shown at once.
        assert all(line_of[slot] == now[slot] for slot in line_of.keys() & now.keys())
        line_of = now
    assert turns == 1
    assert slots.left == start.at(side)
    assert sorted(line_of.values()) == [-2 + side, -1 + side, side, 1 + side]
    kept = set(offsets(start)) & set(line_of)
    assert len(kept) >= 3


def test_a_line_that_is_gone_leaves_its_slot_after_ten_frames() -> None:
    slots = settled([-1.8, 1.8])
    left = slots.at(0)
    for k in range(FRAMES + 1):
        assert slots.counter[left] == max(FRAMES - k, 0)
        slots = seen(slots, [1.8])
    assert sorted(offsets(slots)) == [slots.at(1)]


# --- the whole detector --------------------------------------------------------------------------

FOUR = (Paint(-5.4), Paint(-1.8, 4.0, 12.0), Paint(1.8, 4.0, 12.0), Paint(5.4))


@cache
def pictures() -> tuple[Picture, ...]:
    return tuple(drive(30, FOUR))


def run(given: Sequence[Picture], **more: object) -> list[FrameLines]:
    step = mld.start(SMALL, {**DEFAULTS, **more})  # type: ignore[dict-item]
    return [step(picture) for picture in given]


@needs_compiler
def test_mirrored_pictures_have_mirrored_lines() -> None:
    there = run(pictures())[-1]
    flipped = [replace(p, image=np.ascontiguousarray(p.image[:, ::-1])) for p in pictures()]
    back = run(flipped)[-1]
    assert there.is_valid.tolist() == back.is_valid[::-1].tolist()
    # Random samples are not mirrored, so what they find differs a little.
    np.testing.assert_allclose(there.offset_m, -back.offset_m[::-1], atol=0.1)


@needs_compiler
def test_a_drawn_lane_change_is_followed_line_by_line() -> None:
    lines = (*FOUR, Paint(9.0))
    found = run(drive(50, lines, sideways_m=0.09))
    turned = []
    for k, now in enumerate(found[12:], start=12):
        true = 1.8 - 0.09 * k
        nearest = int(np.abs(now.offset_m - true).argmin())
        assert now.offset_m[nearest] == pytest.approx(true, abs=0.3)
        turned.append(true < 0)
    assert any(turned)
    assert not all(turned)
