"""From a recording to drives: sources, ground truth, clips, roads cut by a map, masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.drives import Drive, drive_names, make_drive, read_drives
from egolane_pgm.loading import load_experiment
from egolane_pgm.maps.road_table import save
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.runs import open_input
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError, LineLog, lane_truth
from tests.kits.drives import GAPS, run, short_drive, simulated, write_drive, write_experiment
from tests.kits.lane_maps import road_rows
from tests.kits.synthetic_road import images, write_pictures, write_place, write_video

#: Lanes of the road, and the seconds that they last.
ROAD = ((3, 20), (4, 20), (3, 20))


def lines(hertz: float = 10.0) -> pd.DataFrame:
    frame = short_drive().log.to_pandas().reset_index()
    return frame.assign(time_s=frame["frame_id"] / hertz)


def lanes() -> pd.DataFrame:
    return short_drive().truth.reset_index().rename(columns={"true_lane": "lane"})


def one(given: Any, overrides: Any = None, **options: Any) -> Drive:
    [drive] = open_input(given, overrides=overrides, **options).drives()
    return drive


# --- sources -------------------------------------------------------------------------------------


@pytest.mark.parametrize("hertz", [10.0, 25.0])
def test_a_frame_of_lines_is_run_as_its_file(tmp_path: Path, hertz: float) -> None:
    of_file = run(write_drive(tmp_path, recording__frame_rate=hertz))
    in_memory = {"experiment": simulated(), "n_lanes": 3, "ground_truth": lanes()}
    found = run(lines(hertz), **in_memory)
    assert found.frame_rate == hertz
    pd.testing.assert_frame_equal(found.frames, of_file.frames)
    assert found.scores == of_file.scores
    assert (found.name, found.run["data"]) == ("in_memory", [])
    # The rate of the experiment goes before that of the times.
    fixed = run(lines(25), {"recording.frame_rate": 5}, **in_memory)
    assert fixed.frame_rate == 5


def test_a_simulated_drive_has_its_own_ground_truth() -> None:
    drive, other = one(simulated()), one(simulated(), {"recording.seed": 6})
    assert drive.has_truth
    assert not np.array_equal(other.true_lane, drive.true_lane)
    assert not one(simulated(), ground_truth="none").has_truth


# --- pictures ------------------------------------------------------------------------------------


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with drive.avi, cam.yaml, run.yaml and the same pictures in pictures/."""
    write_place(tmp_path, 6)
    write_pictures(tmp_path / "pictures", images(6))
    return tmp_path


def test_a_folder_of_pictures_gives_what_the_video_of_them_gives(place: Path) -> None:
    write_video(place / "exact.avi", images(6), four="PNG ")
    keys = {"camera": str(place / "cam.yaml"), "detector": "ml"}
    options = {"experiment": place / "run.yaml", "n_lanes": 3, "recording": keys}
    folder, pattern, video = (
        one(place / name, **options).log for name in ("pictures", "pictures/*.png", "exact.avi")
    )
    assert len(folder) == 6
    for other in (pattern, video):
        np.testing.assert_array_equal(folder.offset_m, other.offset_m)
        np.testing.assert_array_equal(folder.is_valid, other.is_valid)


# --- ground truth --------------------------------------------------------------------------------


def test_the_truth_may_begin_later_and_lack_frames(tmp_path: Path) -> None:
    path, truth = write_drive(tmp_path), short_drive().truth
    kept = truth.iloc[70:].drop(index=[*range(100, 110)])
    write_ground_truth(tmp_path / "ground_truth.txt", kept)
    with pytest.warns(UserWarning, match="80 of 150 frames have no ground truth; filtered, not"):
        drive = one(path)
    ids = drive.log.frame_id[drive.rows]
    np.testing.assert_array_equal(ids, kept.index)
    np.testing.assert_array_equal(drive.true_lane[drive.rows], kept["true_lane"])
    assert len(drive) == len(kept)
    frames = run(path).frames
    assert frames["true_lane"].isna().sum() == frames["is_crossing"].isna().sum() == 80
    write_ground_truth(tmp_path / "ground_truth.txt", truth.set_axis(truth.index + 1000))
    with pytest.raises(InputError, match=r"no common frames: .*lines\.csv has frames 0 to 149, "):
        one(path)


def test_lanes_in_memory_go_with_lines_of_a_file(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    assert set(one(path, ground_truth=lanes().assign(lane=1)).true_lane) == {1}
    with pytest.raises(InputError, match=r"frame 0: lane 7 is outside 1\.\.3; is n_lanes right"):
        one(path, ground_truth=lanes().assign(lane=7))


def test_masked_labels_are_crossing_frames_in_lane_1(tmp_path: Path) -> None:
    drive = one(write_drive(tmp_path), ground_truth=lanes().iloc[20:])
    train = np.arange(40, 90)
    masked = drive.mask_labels(train)
    rows = np.flatnonzero(masked.true_lane > 0)
    np.testing.assert_array_equal(rows, drive.rows)
    kept = rows[train]
    np.testing.assert_array_equal(masked.true_lane[kept], drive.true_lane[kept])
    np.testing.assert_array_equal(masked.is_crossing[kept], drive.is_crossing[kept])
    others = np.setdiff1d(rows, kept)
    assert (masked.true_lane[others] == 1).all()
    assert masked.is_crossing[others].all()
    assert not masked.is_crossing[:20].any()


def test_frames_that_are_never_fitted_are_frame_ids(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    drive = one(
        path, {"fit.untrusted_frames": [[30, 40], [120, None]]}, ground_truth=lanes().iloc[20:]
    )
    trusted = drive.log.frame_id[drive.rows[drive.is_trusted]]
    np.testing.assert_array_equal(trusted, [*range(20, 30), *range(40, 120)])


# --- several drives of one recording -------------------------------------------------------------


def with_clips() -> LineLog:
    log = short_drive().log
    return replace(log, clip=np.where(np.arange(len(log)) < 70, "one", "two"))


def test_each_clip_is_a_drive_from_the_prior_on() -> None:
    found = run(with_clips(), experiment=simulated(), n_lanes=3)
    assert found.frames["drive"].unique().tolist() == ["one", "two"]
    later = run(short_drive().log.take(slice(70, None)), experiment=simulated(), n_lanes=3)
    alone = later.frames
    pd.testing.assert_frame_equal(found.frames.iloc[70:][alone.columns], alone)
    assert set(found.lines) == {"one", "two"}
    with pytest.raises(InputError, match=r"clips have no ground truth; leave out ground_truth"):
        run(with_clips(), experiment=simulated(), n_lanes=3, ground_truth=lanes())


def test_no_frame_is_put_in_between_clips() -> None:
    log = with_clips().take(~np.isin(short_drive().log.frame_id, [*GAPS, 69, 70, 71]))
    options = {"experiment": simulated(), "n_lanes": 3}
    drives = open_input(log, recording={"missing_frames": "hold"}, **options).drives()
    ids = [drive.log.frame_id.tolist() for drive in drives]
    assert ids == [[*range(69)], [*range(72, 150)]]


def test_drives_of_one_name_are_numbered() -> None:
    drives = [replace(one(simulated()), name=name) for name in ("a", "b", "a")]
    assert drive_names(drives) == ["a_1", "b", "a_2"]


# --- a road cut by its map -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def on_road(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment on a drive over ROAD, simulated segment by segment, and its road table."""
    folder = tmp_path_factory.mktemp("road")
    logs, truths = [], []
    for k, (n, seconds) in enumerate(ROAD):
        part = simulate("a4", seed=k, frames=10 * seconds, n_lanes=n)
        begin = sum(len(log) for log in logs)
        frame_id = part.log.frame_id + begin
        logs.append(replace(part.log, frame_id=frame_id, time_s=part.log.time_s + begin / 10))
        truths.append(part.truth.set_axis(part.truth.index + begin))
    write_table(folder / "lines.csv", LineLog.concat(logs))
    write_ground_truth(folder / "truth.txt", pd.concat(truths))
    save(road_rows([n for n, seconds in ROAD for _ in range(seconds)]), folder / "road.parquet")
    return write_experiment(
        folder / "drive.yaml",
        name="a4",
        ground_truth={"path": "truth.txt"},
        road="road.parquet",
        n_lanes="map",
    )


@pytest.mark.parametrize(
    "model",
    [
        {},
        {"graph": "position_in_lane", "evidence": "line_geometry", "filter": "exact"},
        {"filter": "viterbi", "evidence_mode": "hard"},
    ],
    ids=["paper", "position", "path"],
)
def test_each_segment_of_a_road_is_a_drive_from_the_prior_on(
    on_road: Path, model: dict[str, Any]
) -> None:
    whole = run(on_road, model)
    assert (whole.n_lanes, len(whole), whole.frames.index.tolist()) == (4, 600, [*range(600)])
    assert whole.frames["drive"].tolist() == [f"a4_{k}" for k in (1, 2, 3) for _ in range(200)]
    for k, (n, _) in enumerate(ROAD):
        own = {"road": None, "n_lanes": n, "recording.frames": [200 * k, 200 * (k + 1)]}
        alone = run(on_road, {**model, **own}, ground_truth="none").frames
        alone = alone.drop(columns=["true_lane", "is_crossing"])
        there = whole.frames.iloc[200 * k : 200 * (k + 1)]
        pd.testing.assert_frame_equal(there[alone.columns], alone)
        assert set(there["n_lanes"]) == {n}
        further = [f"Lane_{lane}" for lane in range(n + 1, 5)]
        assert not there[further].to_numpy().any()


def test_a_lane_of_the_truth_that_ends_some_metres_later_is_no_error(tmp_path: Path) -> None:
    """The truth has lane 4 for a second after the road has three lanes by its map."""
    log = simulate("a4", seed=0, frames=100, n_lanes=4).log
    write_table(tmp_path / "lines.csv", log)
    lane = np.where(np.arange(100) < 60, 4, 3)
    truth = lane_truth(np.arange(100), lane, np.zeros(100, dtype=bool))
    write_ground_truth(tmp_path / "ground_truth.txt", truth)
    save(road_rows([4] * 5 + [3] * 5), tmp_path / "road.parquet")
    path = write_experiment(tmp_path / "e.yaml", road="road.parquet", n_lanes="map")
    first, second = open_input(path).drives()
    assert (first.model.n_lanes, second.model.n_lanes) == (4, 3)
    assert (second.true_lane[:10] == 4).all()
    assert run(path).scores["model"]["frames_scored"] == 100


def test_what_a_road_needs_is_named(on_road: Path) -> None:
    with pytest.raises(InputError, match=r"road: .*nowhere\.parquet: no such file"):
        run(on_road, {"road": "nowhere.parquet"})
    with pytest.raises(InputError, match="n_lanes: is missing: give the number of lanes"):
        run(on_road.parent / "lines.csv", experiment=on_road)
    with pytest.raises(InputError, match=r"recording\.path: pass the lines that are in memory"):
        read_drives(load_experiment("zero_label", lines=short_drive().log, n_lanes=3))


@pytest.mark.parametrize("lane", [0, 4, -1])
def test_a_lane_outside_the_road_is_refused_naming_file_and_frame(lane: int) -> None:
    [drive] = read_drives(load_experiment(simulated(), n_lanes=3))
    truth = lane_truth([7, 8, 9], [1, lane, 3], [False] * 3, "gt.txt")
    with pytest.raises(InputError, match=rf"^gt.txt: frame 8: lane {lane} is outside 1\.\.3; is"):
        make_drive("x", drive.model, drive.log, truth)
