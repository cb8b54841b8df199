"""Drives over a map of lanes: through interchanges, where lanes begin, end, merge and split.

The car follows a route through a lane graph and changes lane as drivers do: now and then, in time
before its lane ends, and to the lanes that lead to the road that it takes. Its lines are seen by
the simulated detector, and its place by a GNSS receiver. The truth is exact, and so is what may be
wrong with the map: where along the road lanes begin and end, and stretches with a lane more or less
than the map has.

A lane that goes on may get another number where lanes begin or end at its left. A `track` is a lane
with a number that it keeps all along the drive: lane k is track k + left, and `left` changes along
the road. Without a map one is made up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.maps.joins import optional_lanes
from egolane_pgm.maps.lane_graph import LaneGraph, joins_from, way_line
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.simulation._common import (
    Count,
    NotNegative,
    Positive,
    Share,
    check_fields,
    check_seed,
    slow_noise,
)
from egolane_pgm.simulation.detector import DetectorModel, detect_lines, sensor_failures
from egolane_pgm.simulation.presets import PRESETS
from egolane_pgm.simulation.world import Road, ease
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LaneTruth, LineLog

#: The detector that looks at the road.
DETECTOR = PRESETS["a4"].detector

#: The road table looks this far ahead of the car, metres.
_AHEAD_M = 2000.0

#: Metres per degree of latitude, on a sphere.
_DEGREE_M = 111_195.0

#: A mandatory lane change begins at most, and at least, this many seconds before the place.
_LEAD_S = (6.0, 14.0)


@dataclass(frozen=True)
class Journey:
    """How one drives over a map.

    - n_frames, frame_rate: length of the drive; it is shorter where the road ends.
    - lane_width_m: distance between lines.
    - speed_m_s, speed_sd: mean speed and its standard deviation, metres per second.
    - changes_per_minute: lane changes that the road does not ask for.
    - change_s: duration of a lane change, seconds.
    - wander_m, wander_s: standard deviation and correlation time of the place inside the lane.
    - crossing_share: share of a lane change, in its middle, that is annotated as crossing.
    - place_sigma_m: how far from the map's place lanes really begin and end, standard deviation.
      Splits are where the map has them.
    - wrong_per_km: stretches per kilometre on which the road has a lane more or less (at the right)
      than the map; each is `wrong_m` long.
    - wrong_m: see there.
    - gnss_m, gnss_s: standard deviation and correlation time of the error of a position, in either
      direction; one position a second. The defaults are those of four receivers on a recorded
      drive, the errors of its map included.

    Raises InputError, naming the key, for a value out of range.
    """

    n_frames: Count = 6000
    frame_rate: Positive = 10.0
    lane_width_m: Positive = 3.75
    speed_m_s: Positive = 28.0
    speed_sd: NotNegative = 3.0
    changes_per_minute: NotNegative = 2.0
    change_s: Positive = 4.0
    wander_m: NotNegative = 0.2
    wander_s: NotNegative = 5.0
    crossing_share: Share = 0.5
    place_sigma_m: NotNegative = 20.0
    wrong_per_km: NotNegative = 0.0
    wrong_m: Positive = 800.0
    gnss_m: NotNegative = 2.1
    gnss_s: NotNegative = 26.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class InterchangeDrive:
    """A drive of T frames over a map.

    - log: the detected lines. truth: the annotated lane.
    - n_lanes (T,): lanes that there really are; on_map (T,): those that the map has.
    - is_failing (T,): whether the sensor is in its BAD state.
    - road: where the car was on the map, a row a second, without error but for offset_m, which is
      the receiver's.
    - position (R, 2): latitude and longitude that the receiver gave for these rows.
    """

    log: LineLog
    truth: LaneTruth
    n_lanes: IntArray
    on_map: IntArray
    is_failing: BoolArray
    road: RoadTable
    position: FloatArray

    def __len__(self) -> int:
        return len(self.log)


def simulate_interchange(
    seed: int = 0,
    graph: LaneGraph | None = None,
    journey: Journey | None = None,
    detector: DetectorModel = DETECTOR,
) -> InterchangeDrive:
    """Simulate a drive; the same arguments give the same drive.

    - graph: the map; by default one that is made up, another for each seed.

    Raises InputError for a map on which no road with a known number of lanes can be driven.
    """
    journey = journey or Journey()
    rng = np.random.default_rng([check_seed(seed), 3])
    graph = graph or made_up_map(seed)
    at_m = _driven(journey, rng)
    route = _route(graph, float(at_m[-1]), rng)
    at_m = at_m[at_m < route.end_m[-1]]
    on_map = _profile(route, at_m, np.zeros(len(route.joins)))
    late = rng.normal(0.0, journey.place_sigma_m, len(route.joins))
    # Lanes that begin and end in the order of the map, and splits at their place.
    room = np.diff(route.end_m, prepend=0.0)
    room = np.minimum(room[:-1], room[1:]) / 3 if len(room) > 1 else room[:0]
    late = np.clip(late, -room, room)
    late[[graph.join[j] in ("exit", "fork") for j in route.joins]] = 0.0
    lanes, left = _profile(route, at_m, late)
    lanes = _with_errors_of_the_map(lanes, at_m, journey, rng)
    track, centre, is_crossing = _lane_changes(lanes, left, journey, rng)
    lines, position_m = _lines(lanes, left, centre, journey, rng)
    road = Road(
        journey.frame_rate,
        lines.shape[1] - 1,
        position_m,
        track - left,
        is_crossing,
        lines,
        np.full(len(at_m), np.nan),
    )
    is_failing = sensor_failures(detector, road, seed)
    log = detect_lines(road, is_failing, detector, seed)
    rows = np.arange(0, len(at_m), max(1, round(journey.frame_rate)))
    table, places = _table(graph, route, at_m[rows], rows / journey.frame_rate)
    # The receiver is where the car is, beside the way's line.
    across = (centre - left - 0.5)[rows] * journey.lane_width_m
    line = np.where(np.isfinite(table.way_line), table.way_line, on_map[0][rows] / 2)
    across -= line * journey.lane_width_m
    position, off_m = _received(places, across, journey, rng)
    table = replace(table, offset_m=across + off_m)
    return InterchangeDrive(log, road.truth, lanes, on_map[0], is_failing, table, position)


# --- the route ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Route:
    """segments (K,): rows of the graph, in order. joins (K - 1,): rows of its joins between them.
    end_m (K,): metres driven at the end of each."""

    graph: LaneGraph
    segments: IntArray
    joins: IntArray
    end_m: FloatArray


def _route(graph: LaneGraph, metres: float, rng: np.random.Generator) -> _Route:
    """A route of at least `metres`, or the longest of some attempts."""
    can_start = np.flatnonzero((graph.n_lanes > 0) & (graph.length_m > 0))
    start = joins_from(graph)
    if not len(can_start):
        raise InputError("simulation: the map has no road with a known number of lanes")
    best: _Route | None = None
    for _ in range(200):
        here = int(rng.choice(can_start))
        segments, joins, driven = [here], [], float(graph.length_m[here])
        while driven < metres:
            ways = [
                j
                for j in range(start[here], start[here + 1])
                if graph.n_lanes[graph.after[j]] > 0 and graph.after[j] not in segments[-3:]
            ]
            if not ways:
                break
            join = int(rng.choice(ways))
            here = int(graph.after[join])
            joins.append(join)
            segments.append(here)
            driven += float(graph.length_m[here])
        end_m = np.cumsum(graph.length_m[segments])
        if best is None or end_m[-1] > best.end_m[-1]:
            best = _Route(graph, np.array(segments), np.array(joins, dtype=np.int64), end_m)
        if driven >= metres:
            break
    assert best is not None
    return best


def _driven(journey: Journey, rng: np.random.Generator) -> FloatArray:
    """Metres driven in each frame."""
    noise = slow_noise(rng, journey.n_frames, 1, 30.0 * journey.frame_rate)[:, 0]
    speed = np.maximum(journey.speed_m_s + journey.speed_sd * noise, 1.0)
    return np.asarray(np.cumsum(speed) / journey.frame_rate)


def _shift_of(graph: LaneGraph, join: int) -> int:
    """The shift of a join; where the map does not know it, lanes come and go at the right."""
    shift = graph.shift[join]
    return int(shift) if np.isfinite(shift) else 0


def _profile(route: _Route, at_m: FloatArray, late_m: FloatArray) -> tuple[IntArray, IntArray]:
    """Lanes of the road in each frame, and how the drive's numbering is left of it: lane k is track
    k + left. late_m: how far behind its place on the map each join is."""
    graph = route.graph
    piece = np.searchsorted(route.end_m[:-1] + late_m, at_m, side="right")
    shift = np.array([_shift_of(graph, int(j)) for j in route.joins], dtype=np.int64)
    left = -np.concatenate([[0], np.cumsum(shift)])
    return graph.n_lanes[route.segments][piece], left[piece]


def _with_errors_of_the_map(
    lanes: IntArray, at_m: FloatArray, journey: Journey, rng: np.random.Generator
) -> IntArray:
    """The lanes with stretches that have one more or one less at the right."""
    count = rng.poisson(journey.wrong_per_km * float(at_m[-1] - at_m[0]) / 1000)
    real = lanes.copy()
    for place in rng.uniform(at_m[0], at_m[-1], count):
        stretch = (at_m >= place) & (at_m < place + journey.wrong_m)
        by = 1 if lanes[stretch].min() < 2 or rng.random() < 0.5 else -1
        real[stretch] = lanes[stretch] + by
    return real


# --- the car on it -----------------------------------------------------------------------------


def _lane_changes(
    lanes: IntArray, left: IntArray, journey: Journey, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, BoolArray]:
    """The annotated track of the car in each frame, its place in tracks, and the crossing frames.

    It leaves a track that ends in time, and does not enter one that ends soon.
    """
    n, rate = len(lanes), journey.frame_rate
    low, high = left + 1, left + lanes
    length = max(4, round(journey.change_s * rate))
    # A track can be used in a frame if it is there then and for some seconds before and after.
    clear = round(_LEAD_S[1] * rate)
    centre = np.zeros(n)
    track = np.zeros(n, dtype=np.int64)
    is_crossing = np.zeros(n, dtype=bool)
    here = int(rng.integers(low[0], high[0] + 1))
    centre += here
    track += here
    events = np.flatnonzero(np.diff(low) | np.diff(high)) + 1
    hurry = {int(e): float(rng.uniform(*_LEAD_S)) for e in events}
    per_frame = journey.changes_per_minute / 60.0 / rate
    crossing = max(1, round(journey.crossing_share * length))
    t = 1
    while t < n:
        step = 0
        for event in events[(events >= t) & (events < t + 3 * clear)]:
            wanted = int(np.clip(here, low[event], high[event]))
            away = abs(wanted - here)
            begin = hurry[int(event)] * rate + (away - 1) * (length + rate)
            if away and event - t <= begin:
                step = int(np.sign(wanted - here))
                break
        if not step and rng.random() < per_frame:
            step = 1 if rng.random() < 0.5 else -1
            until = min(n, t + length + clear)
            if here + step < low[t:until].max() or here + step > high[t:until].min():
                step = 0
        if not step:
            t += 1
            continue
        stop = min(n, t + length)
        phase = (np.arange(length) + 0.5)[: stop - t] / length
        centre[t:stop] += step * ease(phase)
        centre[stop:] += step
        enters = t + (length - crossing) // 2
        is_crossing[enters : enters + crossing] = True
        track[enters + crossing :] += step
        here += step
        t += length + round(rate)
    # Where a track ended all the same (a very short piece of road), the car is beside it.
    track = np.clip(track, low, high)
    return track, np.clip(centre, low - 0.49, high + 0.49), is_crossing


def _lines(
    lanes: IntArray, left: IntArray, centre: FloatArray, journey: Journey, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """The lines of all tracks as seen from the car (T, L), metres, NaN where a road has none; and
    the car's distance from the first of them (T,)."""
    wander = slow_noise(rng, len(lanes), 1, journey.wander_s * journey.frame_rate)[:, 0]
    place = centre - 0.5 + np.clip(wander, -2.5, 2.5) * journey.wander_m / journey.lane_width_m
    number = np.arange(left.min(), (left + lanes).max() + 1)
    offset = (number - place[:, None]) * journey.lane_width_m
    is_there = (number >= left[:, None]) & (number <= (left + lanes)[:, None])
    position_m = (place - number[0]) * journey.lane_width_m
    return np.where(is_there, offset, np.nan), position_m


# --- the map and the receiver ------------------------------------------------------------------


def _table(
    graph: LaneGraph, route: _Route, at_m: FloatArray, t_s: FloatArray
) -> tuple[RoadTable, FloatArray]:
    """The road table of a drive, and per row latitude, longitude and the heading (radians, from
    north to the east) of the way's line."""
    piece = np.minimum(np.searchsorted(route.end_m, at_m, side="right"), len(route.segments) - 1)
    begin = np.concatenate([[0.0], route.end_m[:-1]])
    segment = route.segments[piece]
    along = at_m - begin[piece]
    # The next join that matters, for each piece of the route.
    matters = np.array(
        [
            graph.join[j] != "same"
            or graph.n_lanes[graph.before[j]] != graph.n_lanes[graph.after[j]]
            or _shift_of(graph, int(j)) != 0
            for j in route.joins
        ],
        dtype=bool,
    )
    following = np.full(len(route.segments), -1)
    for k in range(len(route.segments) - 2, -1, -1):
        following[k] = k if matters[k] else following[k + 1]
    nearest = following[piece]
    in_m = np.where(nearest >= 0, route.end_m[nearest] - at_m, np.nan)
    is_known = (nearest >= 0) & (in_m <= _AHEAD_M)
    join = route.joins[np.maximum(nearest, 0)] if len(route.joins) else np.zeros(len(at_m), int)
    table = RoadTable(
        t_s=t_s,
        segment=segment,
        along_m=along,
        offset_m=np.zeros(len(at_m)),
        sigma_m=np.full(len(at_m), np.nan),
        way_line=way_line(graph, segment, along),
        sure=np.ones(len(at_m)),
        n_lanes=graph.n_lanes[segment],
        next_n_lanes=np.where(is_known, graph.n_lanes[graph.after[join]], 0),
        next_in_m=np.where(is_known, in_m, np.nan),
        next_shift=np.where(is_known, graph.shift[join], np.nan),
        next_join=np.where(is_known, graph.join[join], ""),
        next_side=np.where(is_known, graph.side[join], 0),
        next_optional=np.where(is_known, optional_lanes(graph, join), "")
        if len(route.joins)
        else np.full(len(at_m), ""),
        source="simulated drive",
    )
    places = np.array(
        [_place(graph, int(s), float(a)) for s, a in zip(segment, along, strict=True)]
    )
    return table, places.reshape(-1, 3)


def _place(graph: LaneGraph, segment: int, along_m: float) -> tuple[float, float, float]:
    """Latitude, longitude and heading of a place on a segment."""
    line = graph.line(segment)
    north = np.diff(line[:, 0]) * _DEGREE_M
    east = np.diff(line[:, 1]) * _DEGREE_M * np.cos(np.radians(line[:-1, 0]))
    end = np.cumsum(np.hypot(north, east))
    # The map's lengths are of the ellipsoid, a few thousandths different.
    at = along_m / graph.length_m[segment] * end[-1]
    k = min(int(np.searchsorted(end, at)), len(end) - 1)
    before = end[k - 1] if k else 0.0
    share = (at - before) / max(float(end[k] - before), 1e-9)
    latitude, longitude = line[k] + share * (line[k + 1] - line[k])
    return float(latitude), float(longitude), float(np.arctan2(east[k], north[k]))


def _received(
    places: FloatArray, across_m: FloatArray, journey: Journey, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude that a receiver gives, (R, 2), and how far to the right it errs, (R,).

    - across_m (R,): where the car is, metres right of the way's line."""
    error = journey.gnss_m * slow_noise(rng, len(places), 2, journey.gnss_s)
    latitude, _, heading = places.T
    north = -np.sin(heading) * across_m + error[:, 0]
    east = np.cos(heading) * across_m + error[:, 1]
    degrees = np.stack(
        [north / _DEGREE_M, east / (_DEGREE_M * np.cos(np.radians(latitude)))], axis=1
    )
    off_m = np.cos(heading) * error[:, 1] - np.sin(heading) * error[:, 0]
    return np.asarray(places[:, :2] + degrees), np.asarray(off_m)


# --- maps --------------------------------------------------------------------------------------


def made_up_map(seed: int = 0, n_segments: int = 60) -> LaneGraph:
    """A motorway from interchange to interchange that does not exist, of 2 to 5 lanes.

    Lanes begin and end at either side, mostly at the right; the road splits and merges. The other
    roads at its splits and merges are left out.
    """
    rng = np.random.default_rng([check_seed(seed), 4])
    lanes = [int(rng.integers(2, 5))]
    kinds: list[tuple[str, int, int]] = []
    for _ in range(n_segments - 1):
        n = lanes[-1]
        coin = rng.random()
        change = 1 if n <= 2 else -1 if n >= 5 else (1 if rng.random() < 0.5 else -1)
        if coin < 0.65:
            is_left = rng.random() < 0.15
            kinds.append(("same", change if is_left else 0, -1 if is_left else 1))
        elif change < 0:
            # A road splits off, at the right or at the left, or the car takes it.
            name = "exit" if rng.random() < 0.6 else "fork"
            is_left = rng.random() < 0.3
            change = -1 if name == "exit" or n < 4 else -int(rng.integers(1, n - 1))
            kinds.append((name, change if is_left else 0, -1 if is_left else 1))
        else:
            name = "entry" if rng.random() < 0.6 else "merge"
            is_left = rng.random() < 0.3
            kinds.append((name, change if is_left else 0, -1 if is_left else 1))
        lanes.append(n + change)
    length = rng.uniform(350.0, 1100.0, n_segments)
    latitude = 48.0 + np.concatenate([[0.0], np.cumsum(length)]) / _DEGREE_M
    point = np.stack([latitude, np.full(len(latitude), 11.0)], axis=1)
    index = np.arange(n_segments)
    count = np.array(lanes)
    join, shift, side = zip(*kinds, strict=True)
    return LaneGraph(
        way=index + 1,
        kind=np.full(n_segments, "motorway"),
        name=np.full(n_segments, "A 0", dtype=object),
        n_lanes=count,
        placement=np.stack([count / 2, count / 2], axis=1),
        # Each segment has two points of its own.
        point=np.repeat(point, 2, axis=0)[1:-1],
        first=2 * np.arange(n_segments + 1),
        length_m=length,
        turn=np.full(n_segments, "", dtype=object),
        change=np.full(n_segments, "", dtype=object),
        width=np.full(n_segments, "", dtype=object),
        before=index[:-1],
        after=index[1:],
        shift=np.array(shift, dtype=np.float64),
        join=np.array(join),
        side=np.array(side, dtype=np.int64),
        source=np.full(n_segments - 1, "placement"),
    )


def mirrored(graph: LaneGraph) -> LaneGraph:
    """The map as seen in a mirror: east is west, lane 1 is at the right of what was the road.

    Tags that are written from left to right are left out.
    """
    added = graph.n_lanes[graph.after] - graph.n_lanes[graph.before]
    blank = np.full(len(graph), "", dtype=object)
    lanes = np.where(graph.n_lanes > 0, graph.n_lanes, np.nan)
    return replace(
        graph,
        placement=lanes[:, None] - graph.placement,
        point=graph.point * [1.0, -1.0],
        turn=blank,
        change=blank,
        width=blank,
        shift=added - graph.shift,
        side=-graph.side,
    )
