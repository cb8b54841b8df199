"""Lane changes found in posteriors, and the probability of being on a line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.inference.events import (
    COLUMNS,
    CONFIDENT,
    FLICKER_S,
    HALF_CAR,
    NO_EVENTS,
    RETURN_CONFIDENT,
    across_lanes,
    lane_events,
    lane_segments,
    next_events,
)
from egolane_pgm.types import Beliefs, InputError


def believed(lane: np.ndarray, frame_id: np.ndarray | None = None) -> Beliefs:
    n = len(lane)
    ids = np.arange(n) if frame_id is None else frame_id
    return Beliefs(ids, {"Lane": np.asarray(lane)}, np.zeros(n), np.zeros(n, bool))


def between(*segments: tuple[float, int]) -> Beliefs:
    """Two lanes: P(lane 2), for a number of frames each."""
    right = np.repeat([p for p, _ in segments], [n for _, n in segments])
    return believed(np.stack([1 - right, right], axis=1))


def reported(events: pd.DataFrame) -> list[tuple[int, ...]]:
    columns = ["frame_id", "detected_frame_id", "from_lane", "to_lane"]
    return [tuple(row) for row in events[columns].values.tolist()]


@st.composite
def drives(draw: st.DrawFn) -> Beliefs:
    """Beliefs that are held for a while, more or less sure, over one to four lanes."""
    n_lanes = draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_frames = draw(st.integers(0, 120))
    rows = np.zeros((0, n_lanes))
    while len(rows) < n_frames:
        sure = rng.dirichlet(np.full(n_lanes, rng.choice([0.05, 0.3, 1.0])))
        rows = np.concatenate([rows, np.tile(sure, (int(rng.integers(1, 25)), 1))])
    frame_id = np.cumsum(rng.integers(1, 4, n_frames))
    return believed(rows[:n_frames], frame_id)


@given(drives())
def test_the_segments_of_a_drive_follow_each_other_as_its_changes_do(beliefs: Beliefs) -> None:
    events = lane_events(beliefs, 10.0)
    segments = lane_segments(beliefs.lane, events, beliefs.frame_id / 10)
    sure = beliefs.lane.max(axis=1, initial=0) >= CONFIDENT
    assert len(segments) == (len(events) + 1 if sure.any() else 0)
    for (lane, start, end), (later, begin, _) in pairwise(segments):
        assert lane != later
        assert start <= end == begin
    if segments:
        assert segments[0][:2] == (
            beliefs.lane[sure][0].argmax() + 1,
            beliefs.frame_id[sure][0] / 10,
        )
        assert segments[-1][2] == beliefs.frame_id[-1] / 10
        assert [lane for lane, _, _ in segments[1:]] == events.to_lane.tolist()
        assert [start for _, start, _ in segments[1:]] == events.time_s.tolist()


def plain(lane: np.ndarray, time_s: np.ndarray) -> list[tuple[int, int, int, int]]:
    """The definition, word by word: (row since when, row told, lane left, lane entered)."""
    found: list[tuple[int, int, int, int]] = []
    here = None
    for t in range(len(lane)):
        for k in range(lane.shape[1]):
            if lane[t, k] < CONFIDENT or k == here:
                continue
            if here is None:
                here = k
                continue
            if found:
                _, last, left, _ = found[-1]
                is_soon = time_s[t] < time_s[last] + FLICKER_S
                if k == left - 1 and is_soon and lane[t, k] < RETURN_CONFIDENT:
                    continue
            since = t
            while since > 0 and lane[since - 1, k] > lane[since - 1, here]:
                since -= 1
            found.append((since, t, here + 1, k + 1))
            here = k
    return found


@given(drives(), st.sampled_from([5.0, 10.0, 25.0]))
def test_events_are_those_of_the_definition(beliefs: Beliefs, rate: float) -> None:
    ids = beliefs.frame_id
    events = lane_events(beliefs, rate)
    right = plain(beliefs.lane, ids / rate)
    assert reported(events) == [(ids[s], ids[t], a, b) for s, t, a, b in right]
    np.testing.assert_array_equal(events.time_s, events.frame_id / rate)
    np.testing.assert_array_equal(events.detected_time_s, events.detected_frame_id / rate)
    rows = [t for _, t, _, _ in right]
    np.testing.assert_array_equal(
        events.probability, beliefs.lane[rows, events.to_lane - 1] if rows else []
    )
    assert (events.late_s >= 0).all()


def test_a_change_is_reported_once_believed_and_dated_from_where_the_new_lane_leads() -> None:
    drive = between((0.1, 10), (0.5, 2), (0.6, 3), (0.7, 10))
    assert reported(lane_events(drive, 10.0)) == [(12, 15, 1, 2)]
    assert lane_events(drive, 10.0)["late_s"].tolist() == pytest.approx([0.3])
    assert lane_events(drive, 10.0)["probability"].tolist() == pytest.approx([0.7])


@pytest.mark.parametrize(("short", "n_told"), [(0.0, 3), (1e-9, 1)])
def test_a_probability_that_just_reaches_is_enough(short: float, n_told: int) -> None:
    back = 1 - (RETURN_CONFIDENT - short)
    drive = between((0.05, 10), (0.9, 5), (back, 5), (0.9, 40))
    assert len(lane_events(drive, 10.0)) == n_told
    first = between((0.05, 10), (CONFIDENT - short, 5))
    assert len(lane_events(first, 10.0)) == (short == 0)


def test_a_change_back_is_reported_only_if_it_is_sure() -> None:
    away = ((0.05, 10), (0.9, 5))
    weak, sure = between(*away, (0.1, 10), (0.9, 40)), between(*away, (0.04, 10), (0.9, 40))
    assert reported(lane_events(weak, 10.0)) == [(10, 10, 1, 2)]
    assert reported(lane_events(sure, 10.0)) == [(10, 10, 1, 2), (15, 15, 2, 1), (25, 40 + 5, 1, 2)]


def test_a_car_still_believed_back_is_reported_when_the_time_of_a_flicker_is_over() -> None:
    events = lane_events(between((0.05, 10), (0.9, 5), (0.1, 60)), 10.0)
    assert reported(events) == [(10, 10, 1, 2), (15, 40, 2, 1)]


def test_a_belief_that_comes_with_a_lag_is_reported_when_it_is_known() -> None:
    drive = between((0.1, 10), (0.9, 10))
    assert reported(lane_events(drive, 10.0, lag=4)) == [(10, 14, 1, 2)]
    # The last beliefs come when the drive is over.
    assert reported(lane_events(drive, 10.0, lag=15)) == [(10, 19, 1, 2)]


def test_a_frame_rate_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="frame_rate: 0"):
        lane_events(between((0.1, 3)), 0)


# --- on a line -----------------------------------------------------------------------------------


def over_lines(place: np.ndarray, n_lanes: int, lane: np.ndarray | None = None) -> Beliefs:
    """A car whose place is known, in lane widths right of the middle of the lane where it began;
    of the lane nothing is known, or it is `lane` (T,), from 0."""
    cells = np.floor((place + 0.5) % 1 * 16).astype(int)
    in_lane = np.eye(16)[cells]
    share = np.full((len(place), n_lanes), 1 / n_lanes) if lane is None else np.eye(n_lanes)[lane]
    position = share[:, :, None] * in_lane[:, None, :]
    known = {"Lane": share, "RoadPosition": position.reshape(len(place), -1)}
    return Beliefs(np.arange(len(place)), known, np.zeros(len(place)), np.zeros(len(place), bool))


@pytest.mark.parametrize("n_lanes", [2, 3])
def test_a_change_is_reported_by_its_direction_if_the_lane_is_unknown(n_lanes: int) -> None:
    to_right, back = np.linspace(0, 1, 51), np.linspace(1, -1, 101)
    place = np.concatenate([np.zeros(50), to_right, np.ones(50), back, np.full(50, -1.0)])
    events = lane_events(over_lines(place, n_lanes), 10.0)
    assert events.direction.tolist() == [1, -1, -1]
    assert events.from_lane.tolist() == events.to_lane.tolist() == [0, 0, 0]
    assert np.isnan(events.probability).all()
    # The line is crossed at half a lane; the change is told .15 lane widths beyond it.
    np.testing.assert_allclose(place[events.detected_frame_id], [0.65, 0.35, -0.65], atol=0.07)
    # A car that follows the line changes no lane.
    wavers = 0.5 + 0.1 * np.sin(np.arange(300) / 10)
    assert len(lane_events(over_lines(wavers, n_lanes), 10.0)) == 0
    # Where the lane is known, the change is told with its lanes, once.
    lane = np.rint(place).astype(int) + 1
    known = lane_events(over_lines(place, 3, lane), 10.0)
    assert reported(known) == reported(lane_events(believed(np.eye(3)[lane]), 10.0))
    assert known.direction.tolist() == [1, -1, -1]


def test_a_change_that_determines_the_lane_is_reported_with_its_lanes() -> None:
    """A car somewhere on two lanes goes over a line to the left: it is in lane 1 now."""
    place = np.concatenate([np.zeros(20), np.linspace(0, -1, 51), np.full(60, -1.0)])
    beliefs = over_lines(place, 2)
    lane = beliefs.lane.copy()
    lane[45:] = 0.9, 0.1
    known = {"Lane": lane}
    beliefs = Beliefs(beliefs.frame_id, known, beliefs.log_evidence, beliefs.is_impossible)
    places = across_lanes(over_lines(place, 2).marginals)[1]
    events = lane_events(beliefs, 10.0, lateral_offset=places)
    assert (events.from_lane.tolist(), events.to_lane.tolist()) == ([2], [1])
    assert events.direction.tolist() == [-1]
    # A lane that was believed long before is not the new one: only the direction is known.
    lane[5:] = 0.9, 0.1
    assert reported(lane_events(beliefs, 10.0, lateral_offset=places)) == [
        (*events.detected_frame_id.iloc[[0, 0]], 0, 0)
    ]


def test_an_event_is_one_crossing_of_one_line() -> None:
    """A ramp joins at the left: the lanes get other numbers, before, in and after a change."""
    n = np.zeros(60)
    place = np.concatenate([n, np.linspace(0, 1, 41), n + 1])
    crossed = int(np.argmax(place > 0.5))
    for at, lanes in (
        (30, [(1, 2), (2, 3)]),  # counts the ramp, then follows
        (crossed + 15, [(1, 2), (2, 3)]),  # follows, then counts the ramp
        (30, [(2, 1), (1, 2)]),  # the same to the other side
    ):
        lane = np.full(len(place), lanes[0][0])
        lane[min(at, crossed) :] = lanes[0][1]
        lane[max(at, crossed) :] = lanes[1][1]
        events = lane_events(over_lines(place, 3, lane - 1), 10.0)
        assert reported(events) == [(crossed, crossed, *lanes[at < crossed])]
        assert events.direction.tolist() == [1]
        segments = lane_segments(np.eye(3)[lane - 1], events, np.arange(161) / 10)
        assert [k for k, _, _ in segments] == [lanes[0][0], lanes[0][1], lanes[1][1]]
    # A car that changes no lane: numbers alone are no event.
    lane = np.repeat([0, 1, 0], [60, 41, 60])
    stays = over_lines(0.1 * np.sin(np.arange(161) / 9), 3, lane)
    assert len(lane_events(stays, 10.0)) == 0
    # Unless its place is not known, or was lost shortly before.
    places = across_lanes(stays.marginals)[1]
    assert places is not None
    places[50:55] = np.nan
    assert reported(lane_events(stays, 10.0, lateral_offset=places)) == [(60, 60, 1, 2)]
    assert len(lane_events(over_lines(place, 3, np.zeros(161, int)), 10.0)) == 1


@given(drives(), st.data())
def test_events_with_places_do_not_depend_on_how_a_drive_is_cut_and_are_mirrored(
    beliefs: Beliefs, data: st.DataObject
) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    n = len(beliefs)
    path = np.cumsum(rng.normal(0, rng.choice([0.01, 0.05, 0.2]), n))
    places = np.where(rng.random(n) < 0.02, np.nan, path - np.round(path))
    time_s = beliefs.frame_id / 10
    whole = lane_events(beliefs, 10.0, lateral_offset=places)
    state, parts = NO_EVENTS, []
    cuts = [0, *np.flatnonzero(rng.random(max(n - 1, 0)) < 0.2) + 1, n]
    for part in (slice(a, b) for a, b in pairwise(cuts) if b > a):
        here = beliefs.lane[part], beliefs.frame_id[part], time_s[part], places[part]
        state, _, events = next_events(state, *here)
        parts.append(events)
    for name in COLUMNS.keys() - {"late_s"} if parts else ():
        column = np.concatenate([events[name] for events in parts])
        np.testing.assert_array_equal(column, whole[name], err_msg=name)
    other = believed(beliefs.lane[:, ::-1], beliefs.frame_id)
    mirrored = lane_events(other, 10.0, lateral_offset=-places)
    np.testing.assert_array_equal(mirrored.direction, -whole.direction)
    np.testing.assert_array_equal(mirrored.detected_frame_id, whole.detected_frame_id)


def test_a_lane_that_is_believed_after_a_change_without_lanes_begins_anew() -> None:
    place = np.concatenate([np.zeros(20), np.linspace(0, 1, 51), np.ones(100)])
    beliefs = over_lines(place, 2)
    lane = beliefs.lane.copy()
    lane[100:] = 0.1, 0.9
    beliefs = Beliefs(
        beliefs.frame_id,
        {"Lane": lane, "RoadPosition": beliefs.marginals["RoadPosition"]},
        beliefs.log_evidence,
        beliefs.is_impossible,
    )
    events = lane_events(
        beliefs, 10.0, lateral_offset=across_lanes(over_lines(place, 2).marginals)[1]
    )
    assert reported(events)[0][2:] == (0, 0)
    assert len(events) == 1
    time_s = beliefs.frame_id / 10
    assert lane_segments(beliefs.lane, events, time_s) == [(2, 10.0, 17.0)]


def marginals(position: np.ndarray, n_lanes: int) -> dict[str, np.ndarray]:
    cells = position.shape[1] // n_lanes
    lane = position.reshape(len(position), n_lanes, cells).sum(axis=2)
    return {"Lane": lane, "RoadPosition": position}


@given(st.integers(1, 5), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_being_on_a_line_is_the_share_of_places_near_one(
    n_lanes: int, cells: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    position = rng.dirichlet(np.full(n_lanes * cells, 0.2), 3)
    # Within a cell every place is as probable as the others: many places in each.
    place = (np.arange(n_lanes * cells * 400) + 0.5) / (cells * 400)
    line = np.round(place)
    is_near = (np.abs(place - line) < HALF_CAR) & (line > 0) & (line < n_lanes)
    share = is_near.reshape(-1, 400).mean(axis=1)
    found = across_lanes(marginals(position, n_lanes))[0]
    np.testing.assert_allclose(found, position @ share, atol=0.01)
    mirrored = across_lanes(marginals(position[:, ::-1], n_lanes))[0]
    np.testing.assert_allclose(mirrored, found, atol=1e-12)


def test_a_graph_without_places_gives_no_line_crossing_probability() -> None:
    lane = np.array([[0.5, 0.5]])
    assert across_lanes({"Lane": lane})[0] is None
    # A node of that name that is something else is not taken for the place on the road.
    assert across_lanes({"Lane": lane, "RoadPosition": np.ones((1, 3)) / 3})[0] is None
    other = np.array([[0.7, 0.1, 0.1, 0.1]])
    assert across_lanes({"Lane": lane, "RoadPosition": other})[0] is None
