"""Places and draws the other cars and lorries of the rendered motorway."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import cv2
import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.rendering.strokes import Colour, Project, View, band, fill, hazed

#: The nearest distance at which a vehicle is drawn, metres.
NEAR_M = 0.8

_PAINTS: tuple[Colour, ...] = (
    (200, 200, 200), (60, 60, 62), (28, 28, 30), (150, 150, 152),
    (120, 60, 40), (40, 40, 150), (225, 225, 225), (95, 90, 80),
)  # fmt: skip


@dataclass(frozen=True)
class Traffic:
    """V vehicles.

    - time_s, x_m: (V, 4) times, seconds, and where the vehicle's rear is then, metres ahead of the
      car; linear in between. It is there from the first to the last of these times.
    - d_m: (V,) distance of its middle from the leftmost line, to the right
    - length_m, width_m, height_m: (V,)
    - paint: (V, 3) colour, blue green red
    - is_lorry: (V,)
    """

    time_s: FloatArray
    x_m: FloatArray
    d_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    height_m: FloatArray
    paint: FloatArray
    is_lorry: BoolArray

    def __len__(self) -> int:
        return len(self.d_m)

    def rear_m(self, time_s: float) -> FloatArray:
        """Where the vehicles' rears are, (V,), metres ahead; NaN for those that are not there."""
        out = np.full(len(self), np.nan)
        there = (self.time_s[:, 0] <= time_s) & (time_s <= self.time_s[:, -1])
        for k in np.flatnonzero(there):
            out[k] = np.interp(time_s, self.time_s[k], self.x_m[k])
        return out


@dataclass(frozen=True)
class _Plan:
    """The planned path of a vehicle; the fields are as in Traffic. lane: counted from 0."""

    time_s: tuple[float, float, float, float]
    x_m: tuple[float, float, float, float]
    lane: int
    is_lorry: bool


def make_traffic(
    rng: np.random.Generator,
    time_s: FloatArray,
    position_m: FloatArray,
    lane_middle_m: FloatArray,
    per_minute: FloatArray,
    bursts: list[tuple[float, float]],
) -> Traffic:
    """Makes the vehicles around a drive; none of them collides with the car or with another.

    - time_s, position_m: (T,) the drive: times, and distance from the leftmost line
    - lane_middle_m: (n,) middles of the lanes, from the leftmost line
    - per_minute: (T,) rate at which vehicles come
    - bursts: from and to when, seconds, lorries stay beside the car and a car close ahead of it
    """
    plans: list[_Plan] = []
    for start, end in bursts:
        now = float(np.interp((start + end) / 2, time_s, position_m))
        own = int(np.argmin(np.abs(lane_middle_m - now)))
        plans += _hiding(rng, start, end, own, len(lane_middle_m))
    plans += _flow(rng, time_s, len(lane_middle_m), per_minute)
    whole = _built(rng, plans, lane_middle_m)
    kept = _possible(whole, time_s, position_m)
    return Traffic(*(getattr(whole, field.name)[kept] for field in fields(whole)))


def _hiding(
    rng: np.random.Generator, start: float, end: float, own: int, n_lanes: int
) -> list[_Plan]:
    """Plans lorries beside the car, and perhaps a car ahead of it, from `start` to `end`, seconds.

    own: the car's lane, from 0.
    """
    plans = []
    sides = [lane for lane in (own + 1, own - 1) if 0 <= lane < n_lanes]
    for lane in sides[: 1 + int(rng.random() < 0.4)]:
        hold = float(rng.uniform(3, 9))
        times = (start - 4, start, end, end + 12)
        plans.append(_Plan(times, (-30.0, hold, hold + 5, 170.0), lane, True))
    if rng.random() < 0.7:
        gap = float(rng.uniform(11, 17))
        times = (start - 9, start, end, end + 8)
        plans.append(_Plan(times, (170.0, gap, gap + 3, 170.0), own, False))
    return plans


def _flow(
    rng: np.random.Generator, time_s: FloatArray, n_lanes: int, per_minute: FloatArray
) -> list[_Plan]:
    """Plans vehicles that come and go: those on the left lanes overtake the car, those on the right
    ones are overtaken, and some keep pace ahead of it."""
    minutes = float(time_s[-1] - time_s[0]) / 60.0
    count = int(rng.poisson(float(per_minute.mean()) * minutes))
    weight = np.cumsum(per_minute) / max(float(per_minute.sum()), 1e-9)
    plans = []
    for share in np.sort(rng.random(count)):
        at = float(time_s[min(int(np.searchsorted(weight, share)), len(time_s) - 1)])
        lane = int(rng.integers(0, n_lanes))
        faster = 5.0 * (1 - 2 * lane / max(n_lanes - 1, 1)) + float(rng.normal(0, 2.5))
        if rng.random() < 0.25:
            gap, stay = float(rng.uniform(14, 45)), float(rng.uniform(5, 25))
            times = (at - 10, at, at + stay, at + stay + 12)
            plans.append(_Plan(times, (170.0, gap, gap, 170.0), lane, False))
            continue
        faster = faster if abs(faster) > 1.5 else 1.5
        begin, stop = (-30.0, 170.0) if faster > 0 else (170.0, -30.0)
        third = 200.0 / abs(faster) / 3
        plans.append(
            _Plan(
                (at, at + third, at + 2 * third, at + 3 * third),
                (begin, begin + faster * third, begin + 2 * faster * third, stop),
                lane,
                bool(rng.random() < (0.45 if lane >= n_lanes - 2 else 0.05)),
            )
        )
    return plans


def _built(rng: np.random.Generator, plans: list[_Plan], lane_middle_m: FloatArray) -> Traffic:
    """Makes vehicles of random sizes and colours for the plans."""
    size, paint = [], []
    for plan in plans:
        if plan.is_lorry:
            size.append((rng.uniform(9, 16.5), rng.uniform(2.45, 2.55), rng.uniform(3.2, 4.0)))
            paint.append(np.array([210.0, 212, 215]) * rng.uniform(0.5, 1.08))
        else:
            size.append((rng.uniform(3.9, 4.9), rng.uniform(1.7, 1.9), rng.uniform(1.4, 1.75)))
            paint.append(np.array(_PAINTS[int(rng.integers(len(_PAINTS)))]))
    length_m, width_m, height_m = np.array(size, dtype=np.float64).reshape(-1, 3).T
    lane = np.array([plan.lane for plan in plans], dtype=np.int64)
    return Traffic(
        np.array([plan.time_s for plan in plans], dtype=np.float64).reshape(-1, 4),
        np.array([plan.x_m for plan in plans], dtype=np.float64).reshape(-1, 4),
        lane_middle_m[lane] + rng.normal(0, 0.15, len(plans)),
        length_m,
        width_m,
        height_m,
        np.array(paint, dtype=np.float64).reshape(-1, 3),
        np.array([plan.is_lorry for plan in plans], dtype=bool),
    )


def _possible(traffic: Traffic, time_s: FloatArray, position_m: FloatArray) -> IntArray:
    """The indices of vehicles that keep clear of the car and of those before them in the list."""
    steps = np.arange(0, len(time_s), 3)
    clock, beside_m = time_s[steps], position_m[steps]
    # Pairs are compared only while both are there, which in a long drive are few.
    first = np.searchsorted(clock, traffic.time_s[:, 0], side="left")
    stop = np.searchsorted(clock, traffic.time_s[:, -1], side="right")
    is_kept = np.zeros(len(traffic), dtype=bool)
    track: dict[int, FloatArray] = {}
    for k in range(len(traffic)):
        a, b = int(first[k]), int(stop[k])
        rear = np.interp(clock[a:b], traffic.time_s[k], traffic.x_m[k])
        front = rear + traffic.length_m[k]
        beside = np.abs(traffic.d_m[k] - beside_m[a:b]) < 2.9
        if (beside & (front > -6.0) & (rear < 8.0)).any():
            continue
        same = is_kept & (np.abs(traffic.d_m - traffic.d_m[k]) < 2.0) & (first < b) & (stop > a)
        for j in np.flatnonzero(same).tolist():
            start, end = max(a, int(first[j])), min(b, int(stop[j]))
            mine, other = slice(start - a, end - a), slice(start - first[j], end - first[j])
            before = rear[mine] < track[j][other] + traffic.length_m[j] + 4.0
            if (before & (front[mine] > track[j][other] - 4.0)).any():
                break
        else:
            is_kept[k] = True
            track[k] = rear
    return np.flatnonzero(is_kept)


@dataclass(frozen=True)
class Box:
    """A vehicle in one frame.

    - x, y: (4,) corners on the road in vehicle coordinates: rear left, rear right, front right,
      front left
    - has_rear: whether its rear is far enough ahead to be drawn
    - paint: (3,) colour, blue green red
    """

    x: FloatArray
    y: FloatArray
    height_m: float
    has_rear: bool
    paint: FloatArray
    is_lorry: bool


def boxes(
    traffic: Traffic, time_s: float, position_m: float, side: Callable[[FloatArray], FloatArray]
) -> list[Box]:
    """The vehicles ahead of the car, the farthest first.

    - position_m: distance of the car from the leftmost line
    - side: how far to the right the road bends, metres, at x metres ahead
    """
    rear = traffic.rear_m(time_s)
    front = rear + traffic.length_m
    seen = np.flatnonzero((front > NEAR_M + 0.5) & (rear < 165.0))
    found = []
    for k in seen[np.argsort(-rear[seen], kind="stable")]:
        x = np.array([rear[k], rear[k], front[k], front[k]])
        x = np.maximum(x, NEAR_M)
        half = traffic.width_m[k] / 2
        y = traffic.d_m[k] - position_m + side(x) + half * np.array([-1.0, 1.0, 1.0, -1.0])
        found.append(
            Box(
                x, y, float(traffic.height_m[k]), bool(rear[k] >= NEAR_M), traffic.paint[k],
                bool(traffic.is_lorry[k]),
            )
        )  # fmt: skip
    return found


def hull(box: Box, project: Project) -> tuple[FloatArray, FloatArray]:
    """The convex outline of a vehicle in the picture: u, v of its corners."""
    u, v = project(np.tile(box.x, 2), np.tile(box.y, 2), np.repeat([0.0, box.height_m], 4))
    points = np.stack([u, v], axis=-1)[np.isfinite(u)].astype(np.float32)
    outline = cv2.convexHull(points)[:, 0] if len(points) else np.zeros((0, 2), np.float32)
    return outline[:, 0].astype(np.float64), outline[:, 1].astype(np.float64)


def _inner(
    x: FloatArray, y: FloatArray, part: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """The corners on the road of a part of a vehicle, between two shares of its length.

    x, y: the two corners of one side, or all four.
    """
    if len(x) == 2:
        ends = np.array(part)
        return x[0] + (x[1] - x[0]) * ends, y[0] + (y[1] - y[0]) * ends
    ends = np.array([part[0], part[0], part[1], part[1]])
    near, far = np.array([0, 1, 1, 0]), np.array([3, 2, 2, 3])
    return x[near] + (x[far] - x[near]) * ends, y[near] + (y[far] - y[near]) * ends


def draw_box(view: View, box: Box, light: float) -> None:
    """Draws a vehicle: the shadow below it, its side, its rear. light: 1 in the sun."""
    x, y, top = box.x, box.y, box.height_m

    def shaded(colour: FloatArray | Colour, gain: float) -> Colour:
        lit = np.clip(np.asarray(colour, dtype=np.float64) * gain * light, 0, 235)
        return hazed(lit, float(x[0]))

    middle = y.mean()
    wide = middle + (y - middle) * 1.12
    u, v = view.project(x + np.array([-0.25, -0.25, 0.2, 0.2]), wide, np.zeros(4))
    fill(view.image, u, v, shaded((34, 34, 34), 1.0))
    # A car's cabin is shorter and narrower than its body.
    cabin_x, cabin_y = _inner(x, y, (0.04, 0.72) if not box.is_lorry else (0.0, 1.0))
    cabin_y = middle + (cabin_y - middle) * (1.0 if box.is_lorry else 0.88)
    floor, waist = (0.5, 1.1) if box.is_lorry else (0.25, 0.6 * top)
    for a, b, is_seen in ((1, 2, y[1] < 0), (3, 0, y[0] > 0)):
        if not is_seen:
            continue
        fx, fy = x[[a, b]], y[[a, b]]
        body = (42.0, 42.0, 44.0) if box.is_lorry else shaded(box.paint, 0.72)
        band(view, fx, fy, floor, waist, body)
        ux, uy = cabin_x[[a, b]], cabin_y[[a, b]]
        band(view, ux, uy, waist, top, shaded(box.paint, 0.68))
        if box.is_lorry:
            band(view, ux, uy, 0.55 * top, 0.58 * top, shaded(box.paint, 0.6))
        else:
            band(view, *_inner(ux, uy, (0.06, 0.94)), waist, 0.93 * top, shaded((48, 44, 40), 1.0))
        for place in (0.16, 0.82) if not box.is_lorry else (0.12, 0.2, 0.8):
            share = 0.35 / max(float(np.ptp(fx)), 0.5)
            place = 1 - place if fx[0] > fx[1] else place
            wheel = _inner(fx, fy, (place - share, place + share))
            band(view, *wheel, 0.0, 0.62, shaded((22, 22, 24), 1.0))
    if not box.has_rear:
        return

    def part(
        left: float, right: float, z0: float, z1: float, colour: Colour, cabin: bool = False
    ) -> None:
        fx, fy = (cabin_x[:2], cabin_y[:2]) if cabin else (x[:2], y[:2])
        band(view, fx, fy[0] + (fy[1] - fy[0]) * np.array([left, right]), z0, z1, colour)

    for left in (0.04, 0.8):
        part(left, left + 0.16, 0.0, 0.45, shaded((20, 20, 22), 1.0))
    if box.is_lorry:
        part(0, 1, 0.95, top, shaded(box.paint, 0.9))
        part(0.04, 0.96, 1.05, top - 0.12, shaded(box.paint, 0.8))
        part(0.49, 0.51, 1.05, top - 0.12, shaded((70, 70, 72), 1.0))
        part(0.05, 0.95, 0.5, 0.62, shaded((70, 70, 90), 1.0))
        lights, low = ((0.03, 0.13), (0.87, 0.97)), 0.75
    else:
        part(0, 1, waist, top, shaded(box.paint, 0.85), cabin=True)
        part(0.08, 0.92, waist, 0.92 * top, shaded((52, 48, 44), 1.0), cabin=True)
        part(0, 1, floor, waist, shaded(box.paint, 0.95))
        part(0, 1, floor, floor + 0.12, shaded((40, 40, 42), 1.0))
        part(0.35, 0.65, 0.42, 0.54, shaded((215, 220, 222), 0.9))
        lights, low = ((0.02, 0.2), (0.8, 0.98)), 0.42 * top
    for left, right in lights:
        part(left, right, low, low + 0.16, shaded((40, 30, 170), 1.1))
