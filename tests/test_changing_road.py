"""Experiments whose number of lanes comes from a map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.inference.events import in_tracks, numbered
from egolane_pgm.maps.interchange import Journey, simulate_interchange
from egolane_pgm.maps.road_table import save
from egolane_pgm.online import filter_stream
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import Beliefs, FloatArray, InputError, LaneEvents
from egolane_pgm.views.strips import strip_columns
from tests.kits.lane_maps import without_lines

PLACE = ego.experiments_folder() / "maps" / "interchange.yaml"
SHORT = {"recording.options": {"n_frames": 1200}}


def run(**overrides: Any) -> Any:
    return ego.run(PLACE, overrides={**SHORT, **overrides})


def test_lanes_beyond_those_of_the_map_have_no_probability() -> None:
    done = run()
    result = done
    assert len(np.unique(result.road_lanes)) > 1
    beyond = np.arange(1, result.n_lanes + 1) > result.road_lanes[:, None]
    # Around the map's place a lane may be there already, or still.
    near = np.zeros(len(beyond), dtype=bool)
    for change in np.flatnonzero(np.diff(result.road_lanes)) + 1:
        near[max(0, change - 30) : change + 30] = True
    assert result.marginals["Lane"][beyond & ~near[:, None]].max() < 1e-12
    assert (result.assigned_lane <= result.n_lanes).all()


def test_position_in_lane_follows_lanes_that_begin_and_end() -> None:
    done = ego.run(PLACE.parent / "position.yaml", overrides=SHORT)
    result = done
    assert len(np.unique(result.road_lanes)) > 1
    beyond = np.arange(1, result.n_lanes + 1) > result.road_lanes[:, None]
    assert result.marginals["Lane"][beyond].max() < 1e-12
    road = done.scores["model"]["road"]
    assert min(road[key]["accuracy"] for key in ("behind", "elsewhere")) > 0.9


def test_scores_say_how_well_lanes_are_known_behind_a_change() -> None:
    scores = run().scores["model"]
    road = scores["road"]
    both = road["behind"]["frames"] + road["elsewhere"]["frames"]
    assert (
        both == scores["frames_scored"] == sum(each["frames"] for each in road["by_lanes"].values())
    )
    weighted = sum(road[key]["frames"] * road[key]["accuracy"] for key in ("behind", "elsewhere"))
    assert weighted / both == pytest.approx(scores["accuracy"])


def test_a_strip_is_blank_where_the_map_has_no_lane() -> None:
    result = run()
    strips = strip_columns(result, 0, 1199)
    assert strips.road_lanes is not None
    np.testing.assert_array_equal(strips.road_lanes, result.road_lanes)
    assert strips.truth is not None
    blank = np.isnan(strips.truth[:, ~strips.is_crossing]).sum(axis=0)
    missing = (result.n_lanes - result.road_lanes)[~strips.is_crossing]
    # A truth beside the map's place of a change is shown all the same.
    assert (blank == missing).mean() > 0.95


def test_a_graph_of_a_fixed_road_is_refused() -> None:
    with pytest.raises(InputError, match="graph: sensor_failure is of a road with a fixed number"):
        run(graph="sensor_failure")


def test_evidence_that_is_not_soft_is_refused() -> None:
    with pytest.raises(InputError, match="evidence_reading: hard does not go with a road table"):
        run(evidence_reading="hard")


@pytest.mark.parametrize("place", ["interchange.yaml", "position.yaml"])
def test_the_lane_at_the_start_is_told_of_the_road_that_is_there(place: str) -> None:
    """The drive begins on four lanes of a road that has five later and three in the end."""
    told = ego.run(PLACE.parent / place, overrides={**SHORT, "start_lane": [0, 1, 0, 3]})
    assert told.road_lanes[0] == 4 < told.n_lanes
    assert told.beliefs.lane[0, [0, 2, 4]].max() == 0
    assert np.isfinite(told.beliefs.lane).all()
    with pytest.raises(InputError, match="start_lane: where the drive begins the road has 4 lanes"):
        ego.run(PLACE.parent / place, overrides={**SHORT, "start_lane": 5})
    with pytest.raises(InputError, match="needs a lane, or a number for each of the 5 lanes"):
        ego.run(PLACE.parent / place, overrides={**SHORT, "start_lane": [0, 1, 0, 0, 0, 0]})


def test_n_lanes_map_needs_a_road(tmp_path: Path) -> None:
    content = {"name": "x", "recording": {"path": "lines.csv"}, "n_lanes": "map"}
    with pytest.raises(InputError, match="n_lanes: map needs a road table"):
        ego.load_experiment(content)
    with pytest.raises(InputError, match="road: "):
        ego.run({**content, "road": "nowhere.parquet", "graph": "changing_lanes"})


def test_graphs_are_compared_on_a_road_from_a_map() -> None:
    """With what `run` believes, though one graph is told places around a change and one is not."""
    compared = [PLACE, PLACE.parent / "position.yaml"]
    found = ego.compare(compared, overrides=SHORT)
    for place, name in zip(compared, ("interchange", "position_interchange"), strict=True):
        alone = ego.run(place, overrides=SHORT)
        together = found["interchange, seed 1", name]
        lane = together.marginals["Lane"]
        np.testing.assert_allclose(lane, alone.marginals["Lane"], rtol=0, atol=1e-12)


def test_parameters_are_searched_on_a_road_from_a_map(tmp_path: Path) -> None:
    found = ego.tune(PLACE, trials=2, in_sample_only=True, overrides=SHORT, out=tmp_path / "study")
    assert found is not None


def test_online_says_that_it_does_not_follow_a_map() -> None:
    with pytest.raises(InputError, match="not run online; run the drive with `egolane run`"):
        list(filter_stream(ego.load_experiment(PLACE), ["{}"]))


def test_options_of_the_simulation_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="unknown key 'frames'"):
        ego.run(PLACE, overrides={"recording.options": {"frames": 3}})


def test_changing_lanes_on_a_road_that_does_not_change_is_the_paper_s_model() -> None:
    base = {"name": "x", "recording": {"simulate": "quickstart"}, "n_lanes": 4, "filter": "exact"}
    paper = ego.run(base)
    ours = ego.run({**base, "graph": "changing_lanes"})
    np.testing.assert_allclose(ours.beliefs.lane, paper.beliefs.lane, rtol=0, atol=1e-12)


def test_a_lane_that_gets_another_number_is_no_change_of_lane() -> None:
    """From the second frame on a lane begins at the left: lane 1 is lane 2 then."""
    origin = np.array([0, 1, 1, 1])
    lane = np.array([[0.9, 0.1, 0], [0, 0.9, 0.1], [0, 0.1, 0.9], [0, 0, 1.0]])
    frame_id = np.arange(4)
    beliefs = Beliefs(frame_id, {"Lane": lane}, np.zeros(4), np.zeros(4, dtype=bool))
    tracks = in_tracks(beliefs, origin)
    np.testing.assert_allclose(tracks.lane[:2].argmax(axis=1), [1, 1])
    events: LaneEvents = ego.lane_events(tracks, 10)
    assert len(events) == 1
    told = numbered(events, frame_id, origin)
    assert (told.from_lane.tolist(), told.to_lane.tolist()) == ([2], [3])


def hidden_lines(drive: Any, folder: Path, begin_s: float, stop_s: float) -> dict[str, Any]:
    """An experiment on a drive whose lines are missing for some seconds."""
    behind = (drive.log.time_s >= begin_s) & (drive.log.time_s < stop_s)
    log = without_lines(drive.log, behind)
    write_table(folder / "lines.csv", log)
    write_ground_truth(folder / "truth.txt", drive.truth)
    save(drive.road, folder / "road.parquet")
    return {
        "name": "hidden",
        "recording": {"path": str(folder / "lines.csv")},
        "ground_truth": {"path": str(folder / "truth.txt")},
        "road": str(folder / "road.parquet"),
        "n_lanes": "map",
        "graph": "changing_lanes",
        "filter": "exact",
    }


def test_position_in_lane_doubts_a_guess_where_it_is_one_and_lines_beside_the_car_tell(
    tmp_path: Path,
) -> None:
    drive = simulate_interchange(3, None, Journey(n_frames=900))
    content = hidden_lines(drive, tmp_path, 0.0, 0.0)
    content |= {"graph": "position_in_changing_lanes", "evidence": "line_geometry"}
    # In the first minute the map tells no number, and a lane less is guessed.
    road, begin = drive.road, drive.road.t_s < 60
    fewer = (road.n_lanes - begin, road.next_n_lanes - begin)
    guessed = replace(road, n_lanes=fewer[0], next_n_lanes=fewer[1], untold=begin)
    save(guessed, tmp_path / "road.parquet")

    def lanes(guess_wrong: float) -> FloatArray:
        found = ego.run({**content, "parameters": {"guess_wrong": guess_wrong}}).beliefs.lane
        np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-9)
        return found

    believed, doubted = lanes(0.0), lanes(0.25)
    right = [(each.argmax(axis=1) + 1 == drive.truth.lane).mean() for each in (believed, doubted)]
    assert right[1] > right[0] + 0.05
    told = (drive.log.time_s > 61) & (drive.on_map == 4)
    assert told.any()
    assert doubted[told, 4:].max() < 1e-12
    save(replace(guessed, untold=0 * begin), tmp_path / "road.parquet")
    np.testing.assert_array_equal(lanes(0.25), believed)
    # Who sees the lines of its own lane only has nothing to doubt a guess with.
    save(guessed, tmp_path / "road.parquet")
    log, near = drive.log, np.abs(drive.log.offset_m) < 3.5
    own = replace(log, offset_m=np.where(near, log.offset_m, np.nan), is_valid=log.is_valid & near)
    write_table(tmp_path / "lines.csv", own)
    np.testing.assert_allclose(lanes(0.25)[:, : believed.shape[1]], lanes(0.0), rtol=0, atol=1e-12)


def test_the_lines_of_the_own_lane_alone_do_not_tell_the_number_of_lanes(tmp_path: Path) -> None:
    drive = simulate_interchange(3, None, Journey(n_frames=900))
    content = hidden_lines(drive, tmp_path, 0.0, 0.0)
    log, road = drive.log, drive.road
    near = log.is_valid & (np.abs(log.offset_m) < 3.5)
    write_table(tmp_path / "lines.csv", replace(log, is_valid=near))
    save(replace(road, untold=np.ones_like(road.untold)), tmp_path / "road.parquet")
    result = ego.run(content)
    of_the_map = result.marginals["Lanes"][np.arange(len(log)), result.road_lanes - 1]
    assert of_the_map.min() > 0.2


@pytest.mark.parametrize(
    ("graph", "rule"),
    [("changing_lanes", "counting"), ("position_in_changing_lanes", "line_geometry")],
)
def test_positions_tell_the_lane_where_lines_are_missing(
    tmp_path: Path, graph: str, rule: str
) -> None:
    behind = slice(400, 700)
    gained = []
    for seed in range(1, 5):
        drive = simulate_interchange(seed, None, Journey(n_frames=800))
        content = hidden_lines(drive, tmp_path, 40.0, 70.0)
        found = []
        for gnss in (None, {}):
            done = ego.run({**content, "gnss": gnss, "graph": graph, "evidence": rule})
            right = done.assigned_lane == drive.truth.lane
            found.append(right[behind][~drive.truth.is_crossing[behind]].mean())
        gained.append(found[1] - found[0])
    assert np.mean(gained) > 0.2


def test_positions_go_with_a_constant_number_of_lanes_too(tmp_path: Path) -> None:
    """The table knows no lanes; the number of the experiment counts."""
    drive = simulate_interchange(6, None, Journey(n_frames=800))
    content = hidden_lines(drive, tmp_path, 40.0, 70.0)
    blank = replace(
        drive.road, n_lanes=0 * drive.road.n_lanes, way_line=np.full(len(drive.road), np.nan)
    )
    save(blank, tmp_path / "road.parquet")
    done = ego.run({**content, "n_lanes": 5, "gnss": {"drift_s": 60}})
    assert done.n_lanes == 5
    assert done.road_lanes is None
    without = {key: value for key, value in content.items() if key != "road"}
    lines = ego.run({**without, "n_lanes": 5})
    assert np.abs(done.beliefs.lane - lines.beliefs.lane).max() > 0.1


def test_positions_without_a_road_and_a_road_without_a_use_are_refused() -> None:
    content = {"name": "x", "recording": {"path": "lines.csv"}, "n_lanes": 3}
    with pytest.raises(InputError, match="gnss needs a road table"):
        ego.load_experiment({**content, "gnss": {}})
    with pytest.raises(InputError, match="road goes with n_lanes: map, or with gnss"):
        ego.load_experiment({**content, "road": "road.parquet"})
    with pytest.raises(InputError, match="gnss: unknown key 'sigma'"):
        ego.load_experiment({**content, "road": "road.parquet", "gnss": {"sigma": 1.0}})
    with pytest.raises(InputError, match="graph: sensor_failure is of a road with a fixed number"):
        run(graph="sensor_failure", gnss={})
    with pytest.raises(InputError, match="gnss: positions are for `egolane run`; here leave"):
        ego.tune({**content, "recording": {"simulate": "interchange"}, "gnss": {}}, trials=2)
