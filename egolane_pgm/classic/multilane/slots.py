"""The tracker: six slots, each of which keeps one line for as long as it is seen.

The slots are a ring. Three of them in a row are left of the car and three right of it; when the car
changes lane, the ring turns by one, so a line keeps its slot, and the slot of the line that is now
too far away becomes free for a new one on the other side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from egolane_pgm.classic.multilane import curves
from egolane_pgm.classic.multilane.road import Road, places_of, shapes_of
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: Where a line may be: 0 is directly left of the car, 1 right of it, -1 beyond 0. The slots are
#: filled in this order: the lane's own two lines, their neighbours, the lines beyond those.
PLACES = (0, 1, -1, 2, -2, 3)

#: A line's counter is the number of these last frames in which it was seen.
FRAMES = 10

#: A free slot uses the curves of the last BOOTSTRAP frames ...
BOOTSTRAP = 8

#: ... and takes a line that is in at least SEEN of them ...
SEEN = 4

#: ... at the same place, within this distance, metres.
SAME_M = 0.4

#: Of two such lines next to the car, one this much farther away, metres, needs e times the frames.
NEARER_M = 5.0

#: Number of trials of a robust fit.
TRIALS = 15

#: Largest distance of the points of a robust fit, pixels.
ERROR = 6.0

#: Number of curves tried around a predicted one.
DRAWS = 200

#: Standard deviation of the places of these curves, pixels.
NOISE = 20.0

#: The fewest markings of a fit.
FEWEST = 10

#: The least share of the markings of a fit near the line's last place.
HELD = 0.5

#: The fewest markings of a clear line. With half as many markings the edges of a car next to the
#: line pull it away.
LONG = 120

#: The least part of t that the markings of a clear line span.
SPAN = 0.6

#: Weight of the nearest clear line in the direction of a line that is not clear; the rest is the
#: line's own direction before.
PARALLEL = 0.2

#: The narrowest lane, metres.
LEAST_M = 2.0

#: The widest lane, metres.
WIDEST_LANE_M = 5.0

#: Largest distance of a line that is followed, metres.
FARTHEST_M = 12.0

#: A line has passed under the car when it is this far on the other side, metres.
ACROSS_M = 0.25


@dataclass(frozen=True)
class Slots:
    """The lines that the six slots follow.

    - curve: (6, 3) of each slot; NaN where it is free
    - hits: (6, FRAMES) whether it was seen in each of the last frames, the newest last
    - left: the slot directly left of the car
    - recent: for each of the last BOOTSTRAP frames the curves (C, 3) found without tracking
    """

    curve: FloatArray
    hits: BoolArray
    left: int
    recent: tuple[FloatArray, ...]

    @property
    def is_used(self) -> BoolArray:
        """Mark the slots that hold a line, (6,)."""
        used: BoolArray = np.isfinite(self.curve[:, 0])
        return used

    @property
    def counter(self) -> FloatArray:
        """In how many of the last frames each line was seen, (6,)."""
        count: FloatArray = self.hits.sum(axis=1).astype(np.float64)
        return count

    def at(self, place: int) -> int:
        """The slot in one of PLACES."""
        return (self.left + place) % len(PLACES)

    def without(self, freed: BoolArray) -> Slots:
        """The slots after some, (6,), have become free."""
        curve = np.where(freed[:, None], np.nan, self.curve)
        return replace(self, curve=curve, hits=self.hits & ~freed[:, None])


def no_slots() -> Slots:
    """The slots before the first frame."""
    n = len(PLACES)
    return Slots(np.full((n, 3), np.nan), np.zeros((n, FRAMES), dtype=bool), 2, ())


def advance(
    slots: Slots,
    road: Road,
    t: FloatArray,
    u: FloatArray,
    found: FloatArray,
    most: int,
    rng: np.random.Generator,
) -> Slots:
    """The slots after one more frame.

    - t, u: (F,) its markings
    - found: (C, 3) the curves that are found in it without tracking
    - most: the largest number of slots with a line
    """
    curve = slots.curve.copy()
    is_clear = np.zeros(len(PLACES), dtype=bool)
    for k in np.flatnonzero(slots.is_used):
        draws = rng.random((TRIALS, 3))
        new = _clear(road, t, u, curve[k], draws)
        if new is not None:
            curve[k] = new
            is_clear[k] = True
    clear = curve[is_clear]
    is_hit = is_clear.copy()
    motion = curves.common_motion(slots.curve[is_clear], clear)
    for k in np.flatnonzero(slots.is_used & ~is_clear):
        curve[k] += motion
        noise = rng.normal(0.0, NOISE * road.scale, (DRAWS, 2))
        new = _predicted(road, t, u, curve[k], clear, noise)
        if new is not None:
            curve[k] = new
            is_hit[k] = True
    hits = np.concatenate([slots.hits[:, 1:], is_hit[:, None]], axis=1)
    recent = (*slots.recent, found)[-BOOTSTRAP:]
    slots = _without_lost(Slots(curve, hits, slots.left, recent), road)
    return _filled(_turned(slots, road, most), road, most)


def _near(road: Road, t: FloatArray, u: FloatArray, curve: FloatArray) -> BoolArray:
    """Mark the points, (F,), within two of the widest markings of a curve."""
    reach = 2 * np.interp(t, np.linspace(-1, 1, len(road.widest)), road.widest)
    near: BoolArray = np.abs(u - curves.value(curve, t)) <= reach
    return near


def _has_jumped(road: Road, before: FloatArray, now: FloatArray) -> bool:
    """Whether a line has left the surroundings in which its markings are looked for."""
    return not _near(road, curves.ROWS, curves.value(now, curves.ROWS), before).all()


def _clear(
    road: Road, t: FloatArray, u: FloatArray, before: FloatArray, draws: FloatArray
) -> FloatArray | None:
    """The curve that follows one of the frame before, if its markings alone determine it; or None.

    - draws: (TRIALS, 3) random numbers from 0 to 1
    """
    near = _near(road, t, u, before)
    if near.sum() < LONG * road.row_scale:
        return None
    t = t[near]
    u = u[near]
    held, degree = curves.consensus(t, u, draws, ERROR * road.scale)
    if held.sum() < max(HELD * len(t), LONG * road.row_scale) or np.ptp(t[held]) < SPAN:
        return None
    curve = curves.fit(t[held], u[held], degree)
    return None if _has_jumped(road, before, curve) else curve


def _predicted(
    road: Road,
    t: FloatArray,
    u: FloatArray,
    before: FloatArray,
    clear: FloatArray,
    noise: FloatArray,
) -> FloatArray | None:
    """The curve near one, (3,), that the others' motion predicts, or None.

    - clear: (L, 3) the others
    - noise: (DRAWS, 2) pixels
    """
    near = _near(road, t, u, before)
    if near.sum() < FEWEST * road.row_scale:
        return None
    t = t[near]
    u = u[near]
    held = curves.nearby(t, u, before, noise, ERROR * road.scale)
    if held.sum() < max(HELD * len(t), FEWEST * road.row_scale):
        return None
    t = t[held]
    u = u[held]
    prior = curves.parallel(t, u, before, road.pixels_per_m)
    if len(clear):
        nearest = clear[np.abs(clear[:, 0] - before[0]).argmin()]
        prior += PARALLEL * (curves.parallel(t, u, nearest, road.pixels_per_m) - prior)
    curve = curves.fit(t, u, 2, prior)
    return None if _has_jumped(road, before, curve) else curve


def _without_lost(slots: Slots, road: Road) -> Slots:
    """Free the slots whose line was not seen for long, is too far away or overlaps another."""
    place = places_of(road, slots.curve)
    lost = (slots.counter == 0) | ~(np.abs(place) <= FARTHEST_M)
    kept = [k for k in map(slots.at, sorted(PLACES)) if not lost[k]]
    for one, other in pairwise(kept):
        if place[other] - place[one] < LEAST_M:
            lost[one if slots.counter[one] < slots.counter[other] else other] = True
    return slots.without(lost)


def _turned(slots: Slots, road: Road, most: int) -> Slots:
    """Turn the ring if a line has passed under the car, and free slots outside all PLACES."""
    offset = np.full(len(PLACES), np.nan)
    offset[slots.is_used] = shapes_of(road, slots.curve[slots.is_used])[:, 0]
    to_left = [k for k in PLACES if k > 0 and offset[slots.at(k)] < -ACROSS_M]
    to_right = [k for k in PLACES if k <= 0 and offset[slots.at(k)] > ACROSS_M]
    turn = max(to_left) if to_left else min(to_right) - 1 if to_right else 0
    slots = replace(slots, left=slots.at(turn))
    unused = np.zeros(len(PLACES), dtype=bool)
    unused[[slots.at(k) for k in PLACES[most:]]] = True
    return slots.without(unused)


def _filled(slots: Slots, road: Road, most: int) -> Slots:
    """Fill free slots from the curves of the last frames."""
    if len(slots.recent) < BOOTSTRAP:
        return slots
    found = np.concatenate(slots.recent)
    frame: IntArray = np.repeat(np.arange(BOOTSTRAP), [len(few) for few in slots.recent])
    place = places_of(road, found)
    curve = slots.curve.copy()
    hits = slots.hits.copy()
    for where in PLACES[:most]:
        slot = slots.at(where)
        if np.isfinite(curve[slot, 0]):
            continue
        others = places_of(road, curve)
        is_apart = ~(np.abs(place[:, None] - others) < LEAST_M).any(axis=1)
        is_own = where in (0, 1)
        if is_own:
            # Between the lines that are found there may be one that is not.
            gap = place - others[slots.at(1 - where)]
            fits = ~(np.abs(gap) > 1.5 * WIDEST_LANE_M)
        else:
            gap = place - others[slots.at(where + (1 if where < 0 else -1))]
            fits = np.abs(gap) <= WIDEST_LANE_M
        is_left = place < 0
        chosen = _often_seen(
            place, frame, fits & is_apart & (is_left == (where <= 0)), prefers_near=is_own
        )
        if chosen is not None:
            curve[slot] = found[chosen]
            hits[slot, -1] = True
    return replace(slots, curve=curve, hits=hits)


def _often_seen(
    place: FloatArray, frame: IntArray, fits: BoolArray, *, prefers_near: bool
) -> int | None:
    """The newest curve, an index, at the place where most frames have one; None if too few do.

    - place: (C,) metres; frame: (C,) its frame
    - fits: (C,) which ones are considered
    - prefers_near: whether lines close to the car count more
    """
    best = None
    most = (0.0, 0)
    for k in np.flatnonzero(fits):
        same = fits & (np.abs(place - place[k]) <= SAME_M)
        n_frames = len(np.unique(frame[same]))
        weight = n_frames * np.exp(-abs(place[k]) / NEARER_M) if prefers_near else n_frames
        if n_frames >= SEEN and (weight, frame[k]) > most:
            best = int(k)
            most = (float(weight), int(frame[k]))
    return best
