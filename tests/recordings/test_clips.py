"""Recordings of many clips: which pictures are one, and that each is run from the start."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.select import fill_missing
from egolane_pgm.results import read_result
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import done, refused, write_experiment
from tests.kits.image_line_files import (
    CAMERA,
    OFFSETS,
    ROWS,
    columns,
    culane,
    entry,
    openlane,
    read,
    saved_camera,
    tusimple,
)

#: Clips as the official test labels name them: one labelled picture of each.
OFFICIAL = [f"clips/0530/149262604722217697{k}_0" for k in (6, 3, 8)]


def pictures(clip: str, numbers: Any) -> list[dict[str, Any]]:
    return [entry(0, raw_file=f"{clip}/{number}.jpg") for number in numbers]


def clips_of(log: LineLog) -> list[tuple[str, list[int]]]:
    """The name and the frame ids of each clip."""
    assert log.clip is not None
    return [(str(log.clip[p.start]), log.frame_id[p].tolist()) for p in log.pieces()]


def test_each_folder_of_the_official_test_labels_is_a_clip(tmp_path: Path) -> None:
    labels = [picture for clip in OFFICIAL for picture in pictures(clip, [20])]
    with pytest.warns(UserWarning, match="its 3 clips have fewer than 10 pictures"):
        log = read(tusimple(tmp_path / "test_label.json", labels))
    assert clips_of(log) == [(clip, [k]) for k, clip in enumerate(OFFICIAL)]
    # One picture cannot show that a line persists.
    assert log.is_valid.all()
    assert not read(tmp_path / "test_label.json", valid="hysteresis").is_valid.any()


def test_results_for_whole_clips_keep_the_pictures_of_a_clip_together(tmp_path: Path) -> None:
    rows = [picture for n in range(1, 21) for c in OFFICIAL for picture in pictures(c, [n])]
    log = read(tusimple(tmp_path / "a.json", rows))
    assert clips_of(log) == [
        (clip, list(range(20 * k, 20 * k + 20))) for k, clip in enumerate(OFFICIAL)
    ]
    # A line begins anew in each clip.
    assert log.lri[:, 0].reshape(3, 20)[:, [0, 9, 19]].tolist() == [[1, 10, 10]] * 3
    assert log.is_valid[:, 0].reshape(3, 20).sum(axis=1).tolist() == [11] * 3


@pytest.mark.parametrize("first", [240, 160])
def test_results_as_the_benchmark_takes_them_have_its_rows(tmp_path: Path, first: int) -> None:
    """Without h_samples; the last row is 710."""
    rows = list(range(first, 720, 10))
    lanes = [np.interp(rows, ROWS, columns(o), left=-2).tolist() for o in OFFSETS]
    said = {"raw_file": f"{OFFICIAL[0]}/20.jpg", "lanes": lanes, "run_time": 10}
    nothing = {"raw_file": f"{OFFICIAL[1]}/20.jpg", "lanes": [], "run_time": 10}
    with pytest.warns(UserWarning, match="its 2 clips"):
        log = read(tusimple(tmp_path / "a.json", [said, nothing]))
    np.testing.assert_allclose(log.offset_m[0], OFFSETS, atol=0.02)
    assert np.isnan(log.offset_m[1]).all()
    for lane in ([1.0] * 47, [1.0] * 57, 5):
        with pytest.raises(InputError, match="line 1: has no h_samples, which TuSimple's format"):
            read(tusimple(tmp_path / "b.json", [{**said, "lanes": [*lanes, lane]}]))


def test_two_drives_are_two_clips_and_their_folders_still_count_frames(tmp_path: Path) -> None:
    rows = [entry(0, raw_file=f"clips/0313-{d}/{n}/20.jpg") for d, n in ((1, 60), (1, 62), (2, 7))]
    with pytest.warns(UserWarning, match="its 2 clips"):
        log = read(tusimple(tmp_path / "a.json", rows))
    assert clips_of(log) == [("clips/0313-1", [0, 2]), ("clips/0313-2", [3])]


def test_a_counted_folder_with_several_pictures_is_a_clip_too(tmp_path: Path) -> None:
    rows = pictures("clips/0313-1/60", [19, 20]) + pictures("clips/0313-1/120", [20])
    with pytest.warns(UserWarning, match="its 2 clips"):
        log = read(tusimple(tmp_path / "a.json", rows))
    assert clips_of(log) == [("clips/0313-1/60", [0, 1]), ("clips/0313-1", [2])]


def test_the_folders_below_a_culane_driver_and_an_openlane_split_are_clips(tmp_path: Path) -> None:
    driver = tmp_path / "driver_23_30frame"
    driver.mkdir()
    for name in ("05151640_0419.MP4", "05151643_0420.MP4"):
        culane(driver / name, [30, 90, 60])
        (driver / name / "00030.jpg").write_bytes(b"")
    with pytest.warns(UserWarning, match="clips"):
        log = read(driver, frame_step=30)
    assert clips_of(log) == [
        ("05151640_0419.MP4", [0, 1, 2]),
        ("05151643_0420.MP4", [3, 4, 5]),
    ]
    split = tmp_path / "validation"
    split.mkdir()
    (split / "test_list.txt").write_text("")
    openlane(split / "segment-7", [1, 2])
    openlane(split / "segment-8", [1])
    for file in (split / "segment-8").iterdir():
        file.write_text(file.read_text().replace("segment-7", "segment-8"))
    with pytest.warns(UserWarning, match="clips"):
        log = read(split)
    assert clips_of(log) == [("training/segment-7", [0, 1]), ("training/segment-8", [2])]


def test_no_frame_is_put_in_between_clips(tmp_path: Path) -> None:
    rows = pictures(OFFICIAL[0], [1, 4]) + pictures(OFFICIAL[1], [7, 8])
    log = read(tusimple(tmp_path / "a.json", rows), valid="always")
    filled = fill_missing(log, "hold", 10.0)
    assert clips_of(filled) == [(OFFICIAL[0], [0, 1, 2, 3]), (OFFICIAL[1], [4, 5])]


MADE = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}


def run(folder: Path, labels: Path, name: str) -> Path:
    experiment = write_experiment(folder / "e.yaml", n_lanes=4, ground_truth=None, **MADE)
    camera = saved_camera(folder)
    words = ["--recording", labels, "--camera", camera, "--no-figures", "--out", folder / name]
    (folder / f"{name}.txt").write_text(done("run", experiment, *words).output)
    return folder / name


def test_every_clip_is_run_as_if_it_were_alone(tmp_path: Path) -> None:
    """The second car stands half a lane to the left of the first, the third is the first's road
    seen again: a belief that went on from clip to clip would show."""
    drives = []
    for clip, shift in zip(OFFICIAL, (0.0, -1.7, 0.0), strict=True):
        moved = tuple(offset - shift * 0.9 for offset in OFFSETS)
        drives.append(
            [entry(0, moved, raw_file=f"{clip}/{n}.jpg", classes=[4, 1, 1]) for n in range(1, 16)]
        )
    together = tusimple(tmp_path / "all.json", [row for drive in drives for row in drive])
    result = read_result(run(tmp_path, together, "all"))
    assert result.clip is not None
    for k, drive in enumerate(drives):
        alone = read_result(run(tmp_path, tusimple(tmp_path / f"{k}.json", drive), f"alone{k}"))
        mine = result.marginals["Lane"][15 * k : 15 * k + 15]
        np.testing.assert_allclose(mine, alone.marginals["Lane"], atol=1e-12)
        assert result.clip[15 * k] == OFFICIAL[k]
    assert not np.allclose(result.marginals["Lane"][14], result.marginals["Lane"][15])
    rows = list(csv.DictReader((tmp_path / "all" / "clips.csv").open()))
    assert [row["clip"] for row in rows] == OFFICIAL
    assert [row["first_frame_id"] for row in rows] == ["0", "15", "30"]
    assert {row["frames"] for row in rows} == {"15"}
    assert [int(row["assigned_lane"]) for row in rows] == result.assigned_lane[14::15].tolist()
    said = (tmp_path / "all.txt").read_text()
    assert "3 clips, each from the prior on" in said
    least = min(rows, key=lambda row: float(row["probability"]))
    assert f"least sure: {least['clip']} (" in said
    assert "a row for each clip: clips.csv" in said
    # No change is told from one clip to the next.
    assert len(result.events) == 0
    scores = json.loads((tmp_path / "all" / "scores.json").read_text())
    assert (scores["clips"], scores["lanes"]) == (3, [])


def test_clips_are_refused_where_one_drive_is_needed(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.json", [p for c in OFFICIAL for p in pictures(c, range(12))])
    camera = saved_camera(tmp_path)
    said = refused("convert", labels, tmp_path / "a.csv", "--camera", camera)
    assert said == (
        f"{labels}: has 3 clips, the first {OFFICIAL[0]}; a file that is written holds one drive"
    )
    (tmp_path / "truth.txt").write_text("0;1;0\n")
    recording = {"path": "a.json", "camera": "cam.yaml"}
    path = write_experiment(
        tmp_path / "e.yaml", recording=recording, ground_truth={"path": "truth.txt"}, n_lanes=4
    )
    said = refused("run", path, "--no-figures", "--out", tmp_path / "r")
    assert said.endswith("clips are run without ground truth (ground_truth: none)")
    path = write_experiment(tmp_path / "f.yaml", recording=recording, ground_truth=None)
    said = refused("learn", path, "--unlabelled", "--out", tmp_path / "l")
    assert said.endswith("only `egolane run` takes clips; here name the lines of one")
    words = ["--camera", camera, "--n-lanes", 4, "--out", tmp_path / "b"]
    assert refused("label", labels, *words) == said


# --- OpenLane's lines in metres ------------------------------------------------------------------

#: From the camera's frame (x forward, y left, z up) to the car's: turned 4 degrees down and 1 to
#: the right, 2.1 m high and .3 m left of the middle.
TILT, TURN = np.deg2rad([4.0, -1.0])
DOWN = np.array([[np.cos(TILT), 0, np.sin(TILT)], [0, 1, 0], [-np.sin(TILT), 0, np.cos(TILT)]])
RIGHT = np.array([[np.cos(TURN), -np.sin(TURN), 0], [np.sin(TURN), np.cos(TURN), 0], [0, 0, 1]])
EXTRINSIC = np.eye(4)
EXTRINSIC[:3, :3] = RIGHT @ DOWN
EXTRINSIC[:3, 3] = 1.5, 0.3, 2.1

AHEAD = np.linspace(4, 60, 25)


def label(offset: float, **more: Any) -> dict[str, Any]:
    """A straight line that is `offset` to the right of the car's middle, in the camera's frame."""
    ahead = np.full(len(AHEAD), offset)
    car = np.stack([AHEAD + 1.5, -ahead, 0 * ahead]) - EXTRINSIC[:3, 3:]
    xyz = (EXTRINSIC[:3, :3].T @ car).tolist()
    return {"category": 2, "xyz": xyz, "attribute": 1, "track_id": 4, **more}


def result_line(offset: float) -> dict[str, Any]:
    """The same as a detector's result: points on the road below the camera, x to the right."""
    return {"category": 2, "xyz": [[offset + 0.3, x, 0.0] for x in AHEAD.tolist()]}


def write_segment(folder: Path, lines: list[dict[str, Any]], **more: Any) -> Path:
    folder.mkdir(exist_ok=True)
    for stamp in (150767370180138600, 150767370190138600):
        name = f"validation/segment-1/{stamp}.jpg"
        content = {"file_path": name, "extrinsic": EXTRINSIC.tolist(), "lane_lines": lines, **more}
        (folder / f"{stamp}.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("make", [label, result_line])
def test_lines_in_metres_need_no_camera(tmp_path: Path, make: Any) -> None:
    without_points: list[Any] = [{"xyz": []}, {"xyz": [[], [], []], "visibility": []}]
    given = [make(offset) for offset in OFFSETS]
    folder = write_segment(tmp_path / "s", given + without_points)
    log = read_lines(folder, format="openlane")
    assert log.frame_id.tolist() == [0, 1]
    np.testing.assert_allclose(log.offset_m, [OFFSETS] * 2, atol=0.01)
    assert log.is_continuous.all()
    experiment = write_experiment(
        tmp_path / "e.yaml", recording={"path": "s"}, ground_truth=None, n_lanes=3
    )
    done("run", "--dry-run", experiment)
    done("run", experiment, "--no-figures", "--out", tmp_path / "r")


def test_a_label_with_metres_and_pixels_is_taken_in_metres(tmp_path: Path) -> None:
    both = [label(offset, uv=[[1, 2], [500, 600]]) for offset in OFFSETS]
    log = read_lines(write_segment(tmp_path / "s", both), format="openlane", camera=CAMERA)
    np.testing.assert_allclose(log.offset_m, [OFFSETS] * 2, atol=0.01)


def test_points_that_are_not_visible_are_left_out(tmp_path: Path) -> None:
    line = label(1.8, visibility=[1.0] * 20 + [0.0] * 5)
    line["xyz"][1][20:] = [99.0] * 5
    log = read_lines(write_segment(tmp_path / "s", [line]), format="openlane")
    np.testing.assert_allclose(log.offset_m, 1.8, atol=0.01)
    hidden = write_segment(tmp_path / "s", [label(1.8, visibility=[0.0] * 25), label(0.5)])
    assert np.isfinite(read_lines(hidden, format="openlane").offset_m).sum() == 2


@pytest.mark.parametrize(
    ("lines", "more", "said"),
    [
        ([label(1.8)], {"extrinsic": None}, "lane_lines 1: xyz are in the camera's frame, and the"),
        ([label(1.8)], {"extrinsic": [[1, 2], [3, 4]]}, "extrinsic is no 4 x 4 matrix"),
        ([label(1.8)], {"extrinsic": (2 * np.eye(4)).tolist()}, "extrinsic is no 4 x 4 matrix"),
        ([label(1.8)], {"extrinsic": "no"}, "extrinsic is no 4 x 4 matrix"),
        ([label(1.8, xyz=[[1, 2], [3, 4]])], {}, "xyz is neither lists of x, y and z of the same"),
        ([label(1.8, xyz=[[1, 2], [3], [4]])], {}, "xyz is neither lists of x, y and z of the"),
        ([label(1.8, xyz=5)], {}, "xyz is neither lists of x, y and z of the same"),
        ([label(1.8, xyz=[["a"], [1], [2]])], {}, "xyz is not a list of numbers"),
        ([label(1.8, visibility=[1.0])], {}, "1 visibility for 25 points"),
        ([5], {}, "lane_lines: each line needs to be an object with uv or xyz"),
    ],
)
def test_bad_lines_in_metres_are_refused(
    tmp_path: Path, lines: list[Any], more: dict[str, Any], said: str
) -> None:
    folder = write_segment(tmp_path / "s", lines, **more)
    with pytest.raises(InputError) as caught:
        read_lines(folder, format="openlane")
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(folder))
    assert "\n" not in str(caught.value)
