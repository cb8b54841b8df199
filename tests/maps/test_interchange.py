"""Simulated drives over a map of lanes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import egolane_pgm as ego
from egolane_pgm.command import egolane
from egolane_pgm.maps.interchange import (
    InterchangeDrive,
    Journey,
    made_up_map,
    mirrored,
    simulate_interchange,
)
from egolane_pgm.maps.lane_graph import save
from egolane_pgm.maps.road_table import load
from egolane_pgm.maps.steps import lanes_along, road_changes
from egolane_pgm.types import InputError

SHORT = Journey(n_frames=2000)


@pytest.fixture(scope="module")
def drive() -> InterchangeDrive:
    return simulate_interchange(5, None, Journey(n_frames=4000))


def test_the_same_seed_gives_the_same_drive(drive: InterchangeDrive) -> None:
    again = simulate_interchange(5, None, Journey(n_frames=4000))
    np.testing.assert_array_equal(again.log.offset_m, drive.log.offset_m)
    np.testing.assert_array_equal(again.truth.lane, drive.truth.lane)
    np.testing.assert_array_equal(again.position, drive.position)
    assert not np.array_equal(simulate_interchange(6, None, SHORT).truth.lane, drive.truth.lane)


def test_the_car_is_always_in_a_lane_that_there_is(drive: InterchangeDrive) -> None:
    assert (drive.truth.lane >= 1).all()
    assert (drive.truth.lane <= drive.n_lanes).all()
    assert len(np.unique(drive.n_lanes)) > 2


def test_lanes_begin_and_end_near_where_the_map_has_them(drive: InterchangeDrive) -> None:
    """Within 60 m or so, three standard deviations: 2 to 3 s at 25 m/s."""
    assert 0 < (drive.n_lanes != drive.on_map).mean() < 0.1
    exact = simulate_interchange(5, None, Journey(n_frames=4000, place_sigma_m=0.0))
    np.testing.assert_array_equal(exact.n_lanes, exact.on_map)


def test_the_road_table_tells_the_lanes_of_the_map_frame_by_frame(
    drive: InterchangeDrive,
) -> None:
    steps = road_changes(drive.road).vocabulary()
    most = int(drive.on_map.max())
    along = lanes_along(drive.road, drive.log.time_s, steps=steps, n_lanes=most)
    # Between two rows the car's speed is taken for constant: a frame or two beside the truth.
    assert (along.n_lanes != drive.on_map).mean() < 0.003


def test_the_lines_on_the_road_s_sides_are_those_of_its_lanes() -> None:
    quiet = {"noise_m": 0.0, "clutter": 0.0, "bad_s": 0.0, "miss": 0.0, "offset_scale": 1.0}
    from dataclasses import replace

    from egolane_pgm.maps.interchange import DETECTOR

    seen = simulate_interchange(2, None, SHORT, replace(DETECTOR, **quiet, bad_clutter=0.0))
    offset = np.where(seen.log.is_valid, seen.log.offset_m, np.nan)
    known = ~seen.truth.is_crossing
    lines_left = (offset < 0).sum(axis=1)[known]
    lines_right = (offset > 0).sum(axis=1)[known]
    # A line that has just ended keeps its reliability for ten frames.
    assert (lines_left <= seen.truth.lane[known]).mean() > 0.97
    assert (lines_right <= (seen.n_lanes - seen.truth.lane + 1)[known]).mean() > 0.97


def test_wrong_stretches_have_a_lane_more_or_less_than_the_map() -> None:
    wrong = simulate_interchange(3, None, Journey(place_sigma_m=0, wrong_per_km=0.3))
    off = wrong.n_lanes - wrong.on_map
    assert {-1, 1} >= set(np.unique(off)) - {0}
    assert 0.05 < (off != 0).mean() < 0.6


@pytest.mark.parametrize("seed", [0, 1])
def test_a_map_mirrored_twice_is_the_map(seed: int) -> None:
    graph = made_up_map(seed)
    again = mirrored(mirrored(graph))
    for name in ("placement", "shift", "side", "n_lanes", "point"):
        np.testing.assert_allclose(getattr(again, name), getattr(graph, name), atol=1e-12)
    other = mirrored(graph)
    added = graph.n_lanes[graph.after] - graph.n_lanes[graph.before]
    assert (other.shift[(added == 1) & (graph.shift == 0)] == 1).all()


def test_a_road_that_ends_ends_the_drive() -> None:
    graph = made_up_map(0, n_segments=4)
    short = simulate_interchange(0, graph, Journey(n_frames=6000))
    assert len(short) < 6000
    assert len(short.road) == len(short.position)


def test_a_map_without_lanes_cannot_be_driven() -> None:
    from dataclasses import replace

    graph = made_up_map(0)
    with pytest.raises(InputError, match="no road with a known number of lanes"):
        simulate_interchange(0, replace(graph, n_lanes=0 * graph.n_lanes))


def simulate(*words: str) -> str:
    done = CliRunner().invoke(egolane, ["simulate", "interchange", *words])
    return done.output if done.exit_code == 0 else f"{done.output}{done.exception}"


def test_the_command_writes_what_the_whole_chain_needs_and_it_runs(tmp_path: Path) -> None:
    save(made_up_map(7), tmp_path / "map.parquet")
    folder = tmp_path / "drive"
    said = simulate(
        *("--map", str(tmp_path / "map.parquet"), "--mirror", "--frames", "1500"),
        *("--out", str(folder), "--seed", "2"),
    )
    assert "the number of lanes changes" in said
    names = {file.name for file in folder.iterdir()}
    assert names == {
        *("lines.csv", "ground_truth.txt", "positions.csv", "lanes.parquet", "road.parquet"),
        *("lanes_truth.csv", "experiment.yaml"),
    }
    assert len(load(folder / "road.parquet")) == 150
    run = ego.run(folder / "experiment.yaml")
    run.save(tmp_path / "run")
    assert run.scores["model"]["accuracy"] > 0.5
    scores = json.loads((tmp_path / "run" / "scores.json").read_text())["model"]["road"]
    assert scores["changes"] == sum(
        a != b for a, b in zip(*(_lanes(folder)[k:] for k in (0, 1)), strict=False)
    )
    # A result runs again from its own directory.
    again = ego.run(tmp_path / "run" / "experiment.yaml")
    np.testing.assert_array_equal(again.beliefs.lane, run.beliefs.lane)


def _lanes(folder: Path) -> list[int]:
    rows = (folder / "lanes_truth.csv").read_text().splitlines()[1:]
    return [int(row.split(",")[2]) for row in rows]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--n-lanes", "3"], "--n-lanes: goes without interchange"),
        (["--images"], "--images: goes without interchange"),
        (["--set", "place_sgma_m=3"], "unknown key 'place_sgma_m' (did you mean 'place_sigma_m'?)"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    tmp_path: Path, words: list[str], message: str
) -> None:
    assert message in simulate("--out", str(tmp_path / "drive"), *words)
