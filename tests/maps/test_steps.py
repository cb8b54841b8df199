"""From where a car is on the map to what the graph is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from egolane_pgm.maps.lane_graph import ways_named
from egolane_pgm.maps.on_map import untold_lanes
from egolane_pgm.maps.road_table import RoadTable, load, save
from egolane_pgm.maps.steps import OPTIONAL, SERVED, lanes_along, road_changes
from egolane_pgm.types import InputError, LineLog

SPEED = 25.0


def drive(
    *segments: tuple[float, int, float, str],
    every_s: float = 1.0,
    side: int = 0,
    start_s: float = 0.0,
    optional: str = "",
) -> RoadTable:
    """A car at 25 m/s over segments: length, lanes, and the shift and the kind of the join at its
    end."""
    ends = np.cumsum([length for length, *_ in segments])
    t_s = np.arange(0.0, ends[-1] / SPEED, every_s)
    at = t_s * SPEED
    segment = np.searchsorted(ends, at, side="right")
    last = segment == len(segments) - 1
    following = np.minimum(segment + 1, len(segments) - 1)
    lanes = np.array([n for _, n, _, _ in segments])
    return RoadTable(
        t_s=t_s + start_s,
        segment=segment,
        along_m=at - np.concatenate([[0], ends])[segment],
        offset_m=np.zeros(len(at)),
        sigma_m=np.full(len(at), np.nan),
        way_line=lanes[segment] / 2,
        sure=np.ones(len(at)),
        n_lanes=lanes[segment],
        next_n_lanes=np.where(last, 0, lanes[following]),
        next_in_m=np.where(last, np.nan, ends[segment] - at),
        next_shift=np.where(last, np.nan, np.array([s for *_, s, _ in segments])[segment]),
        next_join=np.where(last, "", np.array([j for *_, j in segments])[segment]),
        next_side=np.where(last, 0, side),
        next_optional=np.where(last, "", optional),
    )


def told(table: RoadTable, rate: float = 10.0, **options: float) -> tuple[list[str], np.ndarray]:
    found = road_changes(table)
    time_s = np.arange(table.t_s[0], table.t_s[-1], 1 / rate)
    n_lanes = int(max(found.n_lanes.max(), 1))
    along = lanes_along(table, time_s, steps=found.vocabulary(), n_lanes=n_lanes, **options)
    words = along.steps.split()
    return [words[k] for k in along.step], along.n_lanes


@pytest.mark.parametrize("every_s", [0.1, 1.0, 3.0])
def test_a_change_is_told_in_the_first_frame_behind_the_join(every_s: float) -> None:
    table = drive((260, 2, 0, "same"), (300, 3, -1, "same"), (500, 2, 0, ""), every_s=every_s)
    words, lanes = told(table)
    assert words[:104] == ["2"] * 104
    assert words[104] == "2>3+0"
    assert words[105:224] == ["3"] * 119
    assert words[224] == "3>2-1"
    assert set(words[225:]) == {"2"}
    assert lanes.tolist() == [2] * 104 + [3] * 120 + [2] * (len(lanes) - 224)


def test_with_an_uncertain_map_the_change_is_told_at_places_around_the_join() -> None:
    words, _ = told(drive((260, 2, 0, "same"), (400, 3, 0, "")), place_sigma_m=20.0)
    places = {k: word for k, word in enumerate(words) if "@" in word}
    # From 40 m before the join to 40 m behind it, every 10 m.
    assert list(places.values()) == [f"2>3+0@{k}" for k in range(1, 10)]
    assert list(places) == [88, 92, 96, 100, 104, 108, 112, 116, 120]
    assert all(words[k] == "hold" for k in range(88, 121) if k not in places)
    assert words[87] == "2"
    assert words[121] == "3"


def test_changes_that_are_close_to_each_other_are_told_where_the_map_has_them() -> None:
    words, _ = told(
        drive((260, 2, 0, "same"), (30, 3, 0, "same"), (400, 4, 0, "")), place_sigma_m=20.0
    )
    assert "2>3+0" in words
    assert "3>4+0" in words
    assert not any("@" in word for word in words)


def test_two_changes_in_one_frame_are_told_one_after_the_other() -> None:
    table = drive((260, 2, 0, "same"), (2, 3, 1, "same"), (400, 4, 0, ""), every_s=0.05)
    words, lanes = told(table, rate=5.0)
    k = words.index("2>3+0")
    assert words[k : k + 3] == ["2>3+0", "3>4+1", "4"]
    assert lanes[k : k + 2].tolist() == [3, 4]


def test_at_a_split_the_lanes_that_serve_the_branch_are_evidence_in_the_frame_before() -> None:
    table = drive((260, 4, -2, "exit"), (400, 2, 0, ""))
    found = road_changes(table)
    time_s = np.arange(0, 20, 0.1)
    along = lanes_along(table, time_s, steps=found.vocabulary(), n_lanes=4, place_sigma_m=20.0)
    frame = int(along.changes[0])
    other = 1 - SERVED
    np.testing.assert_allclose(along.served[frame - 1], [other, other, SERVED, SERVED])
    assert (np.delete(along.served, frame - 1, axis=0) == 1).all()
    assert along.steps.split()[along.step[frame]] == "4>2-2"


def test_a_lane_that_also_leads_elsewhere_is_half_of_one_that_leads_to_the_branch_only() -> None:
    table = drive((260, 3, -1, "fork"), (400, 2, 0, ""), optional="2")
    found = road_changes(table)
    assert found.optional == ((2,),)
    along = lanes_along(table, np.arange(0, 20, 0.1), steps=found.vocabulary(), n_lanes=4)
    frame = int(along.changes[0])
    # The fourth lane, which the map does not have, is as the last one.
    np.testing.assert_allclose(along.served[frame - 1], [1 - SERVED, OPTIONAL, SERVED, SERVED])


def test_optional_lanes_that_are_none_are_refused() -> None:
    table = drive((260, 3, -1, "fork"), (400, 2, 0, ""), optional="middle")
    with pytest.raises(InputError, match="row 10: next_optional: 'middle' are no lanes such as"):
        road_changes(table)


def test_staying_on_the_road_at_an_exit_without_lanes_of_its_own_says_nothing() -> None:
    table = drive((260, 3, 0, "exit"), (400, 3, 0, ""))
    along = lanes_along(table, np.arange(0, 20, 0.1), steps="3 hold", n_lanes=3)
    np.testing.assert_allclose(along.served, np.where(along.served < 1, SERVED, 1.0))


def test_an_unknown_shift_is_a_step_of_unknown_side_and_a_known_side_tells_it() -> None:
    unknown = drive((260, 2, np.nan, "same"), (400, 3, 0, ""))
    assert [str(s) for s in road_changes(unknown).steps] == ["2>3?"]
    for side, word in ((1, "2>3+0"), (-1, "2>3+1")):
        known = drive((260, 2, np.nan, "same"), (400, 3, 0, ""), side=side)
        assert [str(s) for s in road_changes(known).steps] == [word]


def test_lanes_that_the_map_does_not_know_are_those_before() -> None:
    table = drive((260, 2, 0, "same"), (300, 0, 0, "same"), (400, 2, 0, ""))
    assert set(told(table)[0]) == {"2"}
    lost = replace(table, segment=np.where(table.t_s > 5, -1, table.segment))
    assert set(told(replace(lost, n_lanes=np.where(lost.segment < 0, 0, 2)))[0]) == {"2"}


def test_a_guess_begins_and_ends_with_a_step_of_its_own() -> None:
    table = drive((260, 2, 0, "same"), (300, 2, 0, "same"), (300, 3, 0, "same"), (400, 3, 0, ""))
    table = replace(table, untold=np.where(np.isin(table.segment, [1, 2]), 77, 0))
    found = road_changes(table, doubts_guesses=True)
    assert [str(step) for step in found.steps] == ["2>2?~", "2>3+0~", "3>3?"]
    time_s = np.arange(0, 50, 0.1)
    along = lanes_along(table, time_s, steps=found.vocabulary(is_exact=True), n_lanes=4)
    words = [along.steps.split()[k] for k in along.step]
    assert list(dict.fromkeys(words)) == ["2", "2>2?~", "2~", "2>3+0~", "3~", "3>3?", "3"]
    assert words.index("2>2?~") == 104
    # Where the road goes on with as many lanes, the map has no change.
    assert along.changes.tolist() == [224]
    assert [str(step) for step in road_changes(table).steps] == ["2>3+0"]


def test_a_run_says_where_the_map_does_not_tell_the_lanes() -> None:
    table = drive((250, 2, 0, "same"), (250, 0, 0, "same"), (500, 2, 0, ""))
    nothing = np.zeros((200, 1))
    frames = np.arange(200)
    log = LineLog(frames, frames / 5, nothing, nothing > 0, nothing > 0, nothing)
    goes_on = "; the number before goes on"
    unknown = "road table: in 50 of 200 frames the map does not tell how many lanes the road has"
    assert untold_lanes(table, log) == [unknown + goes_on]
    guessed = replace(table, n_lanes=table.n_lanes.clip(2), untold=77 * (table.n_lanes == 0))
    assert untold_lanes(guessed, log) == [f"{unknown} (way 77); the number is a guess"]
    off = replace(table, segment=np.where(table.n_lanes == 0, -1, 0))
    assert untold_lanes(off, log) == [
        f"road table: in 50 of 200 frames the car is off the map{goes_on}"
    ]
    assert untold_lanes(drive((260, 2, 0, "")), log) == []
    assert ways_named(np.array([7, 7, 5, 1, 2, 3])) == "ways 7, 5, 1 and 2 more"


def test_off_the_map_a_change_is_of_unknown_side() -> None:
    table = drive((260, 2, 0, "same"), (300, 0, 0, "same"), (400, 3, 0, ""))
    off = (table.t_s > 9) & (table.t_s < 23)
    nothing = np.where(off, np.nan, table.along_m)
    table = replace(
        table,
        segment=np.where(off, -1, table.segment),
        along_m=nothing,
        next_in_m=np.where(off, np.nan, table.next_in_m),
        n_lanes=np.where(off, 0, table.n_lanes),
    )
    assert [str(s) for s in road_changes(table).steps] == ["2>3?"]


def test_the_origin_follows_lanes_that_come_and_go_at_the_left() -> None:
    table = drive((260, 2, 1, "same"), (300, 3, -1, "same"), (400, 2, 0, ""))
    found = road_changes(table)
    along = lanes_along(table, np.arange(0, 30, 0.1), steps=found.vocabulary(), n_lanes=3)
    assert along.origin[[0, 110, 250]].tolist() == [0, 1, 0]


def test_clocks_that_do_not_overlap_are_refused_with_both_ranges() -> None:
    table = drive((260, 2, 0, "same"), (400, 3, 0, ""), start_s=1.6e9)
    with pytest.raises(InputError, match=r"1\.6e\+09 to .* and lines\.csv has 0 to 9\.9 s"):
        lanes_along(table, np.arange(0, 10, 0.1), steps="2", n_lanes=3, source="lines.csv")


def test_a_road_of_nothing_known_or_of_too_many_lanes_is_refused() -> None:
    with pytest.raises(InputError, match="no row knows how many lanes"):
        road_changes(drive((260, 0, 0, "same"), (400, 0, 0, "")))
    with pytest.raises(InputError, match="a road of 80 lanes; at most 50"):
        road_changes(drive((260, 2, 0, "same"), (400, 80, 0, "")))


def test_a_road_that_the_graph_does_not_have_is_refused() -> None:
    table = drive((260, 2, 0, "same"), (400, 3, 0, ""))
    time_s = np.arange(0, 20, 0.1)
    with pytest.raises(InputError, match=r"the step '2>3\+0' of this road is not among"):
        lanes_along(table, time_s, steps="2 3", n_lanes=3)
    with pytest.raises(InputError, match="the road has 3 lanes, n_lanes is 2"):
        lanes_along(table, time_s, steps=road_changes(table).vocabulary(), n_lanes=2)


def test_a_road_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    table = drive((260, 2, 0, "same"), (400, 3, 0, ""))
    save(table, tmp_path / "road.parquet")
    back = load(tmp_path / "road.parquet")
    assert len(back) == len(table)
    np.testing.assert_array_equal(back.next_join, table.next_join)
    np.testing.assert_array_equal(back.next_in_m, table.next_in_m)
    # A table that was written before there was this column.
    older = parquet.read_table(tmp_path / "road.parquet").drop_columns(["untold"])
    parquet.write_table(older, tmp_path / "road.parquet")
    assert not load(tmp_path / "road.parquet").untold.any()


def test_what_is_no_road_table_is_refused(tmp_path: Path) -> None:
    table = drive((260, 2, 0, "same"), (400, 3, 0, ""))
    with pytest.raises(InputError, match=r"x\.csv: a road table is a \.parquet file"):
        save(table, tmp_path / "x.csv")
    with pytest.raises(InputError, match=r"none\.parquet: cannot be read: No such"):
        load(tmp_path / "none.parquet")
    other = tmp_path / "other.parquet"
    parquet.write_table(pa.table({"t_s": [1.0]}), other)
    with pytest.raises(InputError, match=r"no road table; `egolane locate"):
        load(other)
    with pytest.raises(InputError, match="row 1: t_s does not increase"):
        replace(table, t_s=np.zeros(len(table)))
