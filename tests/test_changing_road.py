"""A recording whose number of lanes comes from a map: several drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.maps.road_table import save
from egolane_pgm.online import filter_stream
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError
from egolane_pgm.views.strips import strip_columns
from tests.kits.lane_maps import road_rows

#: Lanes of the road, and the seconds that they last.
ROAD = ((3, 20), (4, 20), (3, 20))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment on a drive over the road, simulated stretch by stretch, with its road table."""
    folder = tmp_path_factory.mktemp("road")
    logs, truths = [], []
    for k, (n, seconds) in enumerate(ROAD):
        part = simulate("a4", seed=k, frames=10 * seconds, n_lanes=n)
        begin = sum(len(log) for log in logs)
        frame_id = part.log.frame_id + begin
        logs.append(replace(part.log, frame_id=frame_id, time_s=part.log.time_s + begin / 10))
        truths.append(np.stack([frame_id, part.truth.lane, part.truth.is_crossing]))
    write_table(folder / "lines.csv", ego.LineLog.joined(logs))
    frame_id, lane, is_crossing = np.concatenate(truths, axis=1)
    truth = ego.LaneTruth(frame_id, lane, is_crossing.astype(bool))
    write_ground_truth(folder / "truth.txt", truth)
    save(road_rows([n for n, seconds in ROAD for _ in range(seconds)]), folder / "road.parquet")
    (folder / "drive.yaml").write_text(
        "name: a4\nrecording: {path: lines.csv}\nground_truth: {path: truth.txt}\n"
        "road: road.parquet\nn_lanes: map\n"
    )
    return folder / "drive.yaml"


@pytest.mark.parametrize(
    "model",
    [
        {},
        {"graph": "position_in_lane", "evidence": "line_geometry", "filter": "exact"},
        {"filter": "smoothed", "decode": "viterbi", "evidence_reading": "hard"},
    ],
    ids=["paper", "position", "path"],
)
def test_each_stretch_is_a_drive_of_its_own(drive: Path, model: dict[str, Any]) -> None:
    whole = ego.run(drive, overrides=model)
    assert (whole.n_lanes, len(whole)) == (4, 600)
    for k, (n, _) in enumerate(ROAD):
        rows = slice(200 * k, 200 * (k + 1))
        own = {"road": None, "n_lanes": n, "ground_truth": None}
        frames = {"recording.frames": [rows.start, rows.stop]}
        alone = ego.run(drive, overrides={**model, **own, **frames})
        for node, belief in alone.marginals.items():
            there = whole.marginals[node][rows]
            np.testing.assert_array_equal(there[:, : belief.shape[1]], belief)
            assert not there[:, belief.shape[1] :].any()
        np.testing.assert_array_equal(whole.assigned_lane[rows], alone.assigned_lane)
        table = {name: column[k] for name, column in whole.clip_columns().items()}
        assert (table["clip"], table["n_lanes"]) == (f"a4_{k + 1}", n)
        right = (whole.assigned_lane == whole.true_lane)[rows][~whole.is_crossing[rows]]
        assert (table["frames_scored"], table["accuracy"]) == (len(right), right.mean())


def test_scores_are_those_of_all_drives(drive: Path) -> None:
    result = ego.run(drive)
    table, scores = result.clip_columns(), result.scores["model"]
    assert scores["frames_scored"] == table["frames_scored"].sum()
    right = (table["accuracy"] * table["frames_scored"]).sum()
    assert scores["accuracy"] == pytest.approx(right / scores["frames_scored"])
    # Lanes that get other numbers at a border are no change of lane.
    of_drives = [
        np.count_nonzero(np.diff(lane[~crosses]))
        for k in range(3)
        for lane, crosses in [
            (result.true_lane[200 * k :][:200], result.is_crossing[200 * k :][:200])
        ]
    ]
    assert result.scores["events"]["changes"] == sum(of_drives)
    text = result.to_text(wide=True)
    assert "| a4_2  |     4 |" in text
    assert "accuracy" in text


def test_a_result_is_read_as_it_was_written_and_runs_again(drive: Path, tmp_path: Path) -> None:
    result = ego.run(drive)
    result.save(tmp_path / "out")
    again = ego.load_result(tmp_path / "out")
    for name, column in result.columns().items():
        np.testing.assert_array_equal(again.columns()[name], column, err_msg=name)
    assert (tmp_path / "out" / "clips.csv").read_text().startswith("clip,first_frame_id,frames")
    assert again.model.n_lanes == 4
    rerun = ego.run(tmp_path / "out" / "experiment.yaml")
    np.testing.assert_array_equal(rerun.marginals["Lane"], result.marginals["Lane"])
    assert result.report(tmp_path / "page.html").is_file()


def test_a_strip_is_blank_where_the_road_has_no_lane(drive: Path) -> None:
    result = ego.run(drive)
    strips = strip_columns(result, 0, 599)
    np.testing.assert_array_equal(np.isnan(strips.beliefs["Model"][3]), result.road_lanes == 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"road": None}, "n_lanes: map needs a road table"),
        ({"road": "nowhere.parquet"}, "road: "),
        ({"n_lanes": 3}, "n_lanes: a road table gives the number of lanes"),
        ({"start_lane": 1}, "start_lane: does not go with n_lanes: map"),
    ],
)
def test_what_does_not_go_with_a_map_is_refused(
    drive: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        ego.run(drive, overrides=changes)


@pytest.mark.parametrize(
    "use",
    [
        lambda drive: ego.tune(drive, trials=2),
        lambda drive: ego.compare([drive]),
        lambda drive: ego.learn(drive),
        lambda drive: list(filter_stream(ego.load_experiment(drive), ["{}"])),
    ],
    ids=["tune", "compare", "learn", "online"],
)
def test_only_a_run_cuts(drive: Path, use: Callable[[Path], object]) -> None:
    with pytest.raises(InputError, match="n_lanes: map: only `egolane run` cuts a recording"):
        use(drive)


def test_another_recording_needs_its_own_number(drive: Path) -> None:
    lines = drive.parent / "lines.csv"
    with pytest.raises(InputError, match=r"n_lanes: is missing.*the map of .* is of its own road"):
        ego.run(drive, recording=lines)
