"""What other lane detectors write: TuSimple's format as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.table import read_table, write_table
from egolane_pgm.result import load_result
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.formats.tusimple import (
    ImageLine,
    offset_of,
    persistence,
)
from tests.kits.drives import done, write_experiment
from tests.kits.image_line_files import (
    CAMERA,
    OFFSETS,
    ROWS,
    entry,
    read,
    saved_camera,
    tusimple,
    whats_wrong,
)


def test_tusimple_lines_get_their_offsets_at_the_car_from_left_to_right(tmp_path: Path) -> None:
    shuffled = [entry(k, OFFSETS[::-1], classes=[2, 1, 4]) for k in (7, 5, 6)]
    log = read(tusimple(tmp_path / "a.jsonl", shuffled))
    assert log.frame_id.tolist() == [5, 6, 7]
    np.testing.assert_allclose(log.time_s, [0.5, 0.6, 0.7])
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (3, 1)), atol=0.01)
    assert log.is_continuous.tolist() == [[True, False, True]] * 3


def test_a_clip_is_numbered_by_its_folder_and_a_picture_by_its_name(tmp_path: Path) -> None:
    for names in (
        ["clips/0313-1/40/20.jpg", "clips/0313-1/7/20.jpg"],
        ["drive2/frame_00007.jpg", "drive2/frame_00040.jpg"],
        ["40.png", "7.png"],
    ):
        log = read(tusimple(tmp_path / "a.jsonl", [entry(0, raw_file=name) for name in names]))
        assert log.frame_id.tolist() == [7, 40]


@pytest.mark.parametrize(("first", "n_rows"), [(240, 48), (160, 56)])
def test_results_for_the_benchmark_have_its_own_rows(
    tmp_path: Path, first: int, n_rows: int
) -> None:
    result = {"raw_file": "a/1.jpg", "lanes": [[600 - 3 * k for k in range(n_rows)]]}
    rows = list(range(first, 720, 10))
    log, same = (
        read(tusimple(tmp_path / "a.jsonl", [each]))
        for each in (result, result | {"h_samples": rows})
    )
    assert np.isfinite(log.offset_m).all()
    np.testing.assert_array_equal(log.offset_m, same.offset_m)


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=1), st.floats(-0.03, 0.03))
def test_an_offset_comes_back_whatever_the_heading(offsets: list[float], heading: float) -> None:
    x = np.linspace(5, 45, 30)
    u, v = road_to_image(CAMERA, x, offsets[0] + heading * x)
    assert offset_of(ImageLine(u, v), CAMERA) == pytest.approx(offsets[0], abs=0.02)


def test_a_line_seen_only_far_ahead_above_the_horizon_or_in_one_row_has_no_offset() -> None:
    far = np.linspace(30, 60, 10)
    assert np.isnan(offset_of(ImageLine(*road_to_image(CAMERA, far, 0 * far)), CAMERA))
    sky = ImageLine(np.array([600.0, 610.0, 620.0]), np.array([20.0, 50.0, 90.0]))
    assert np.isnan(offset_of(sky, CAMERA))
    # A point says where the line is, and not where it goes.
    one_row = ImageLine(np.array([600.0]), np.array([500.0]))
    assert np.isnan(offset_of(one_row, CAMERA))


def rows(*offsets: Sequence[float]) -> list[np.ndarray]:
    return [np.array(row, dtype=float) for row in offsets]


def test_lri_counts_the_sightings_in_the_last_ten_frames_and_valid_has_hysteresis() -> None:
    # Seen ten times, missed six, seen again.
    seen = [[1.8]] * 10 + [[]] * 6 + [[1.8]] * 10
    lri, valid = persistence(rows(*seen), np.arange(len(seen)) / 10)
    assert [row.tolist() for row in lri[:10]] == [[float(k)] for k in range(1, 11)]
    assert [row.tolist() for row in valid[8:10]] == [[False], [True]]
    # Four of the last ten were seen when it was gone for six: below half, no longer valid.
    assert lri[16].tolist() == [4.0]
    assert not valid[16].any()
    assert lri[24].tolist() == [9.0]
    assert valid[25].all()


def test_missing_frames_are_no_misses_but_after_a_second_everything_is_new() -> None:
    ids = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 12, 40, 41])
    lri, valid = persistence(rows(*[[1.8]] * len(ids)), ids / 10)
    assert lri[9].tolist() == [10.0]
    assert valid[9].all()
    assert [lri[10].tolist(), lri[11].tolist()] == [[1.0], [2.0]]
    assert not valid[10].any()


def test_labels_are_converted_and_run_like_any_recording(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.jsonl", [entry(k, classes=[4, 1, 1]) for k in range(30)])
    camera = saved_camera(tmp_path)
    write_table(tmp_path / "a.parquet", read_lines(labels, camera=camera))
    log = read_table(tmp_path / "a.parquet")
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (30, 1)), atol=0.01)
    assert log.lri[-1].tolist() == [10, 10, 10]
    made = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    experiment = write_experiment(tmp_path / "e.yaml", ground_truth=None, **made)
    words = ["--camera", camera, "--no-figures", "--out", tmp_path / "r"]
    done("run", labels, "--experiment", experiment, *words)
    # A continuous line two to the left: the car is in lane 2.
    assert load_result(tmp_path / "r").frames["assigned_lane"].iloc[-1] == 2


def test_lines_in_pixels_without_a_camera_are_refused(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.jsonl", [entry(1)])
    with pytest.raises(InputError, match="its lines are in pixels: name the camera's YAML file"):
        read_lines(labels)
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read: No such file"):
        read_lines(labels, camera=tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lanes": [[1.0, 2.0]]}, f"line 2: lane 1 has 2 values for {len(ROWS)} h_samples"),
        ({"lanes": [["x"] * len(ROWS)]}, "line 2: lane 1 is not a list of numbers"),
        ({"h_samples": [float("nan")] * len(ROWS)}, "h_samples is not a list of numbers"),
        ({"raw_file": "clips/0313-1/1/20.jpg"}, "line 2: frame 1 is there twice"),
        ({"raw_file": 5}, "line 2: has no raw_file (str), which TuSimple's"),
        ({"raw_file": f"a/{'9' * 19}.jpg"}, "999' has no frame number in it"),
        ({"lanes": None}, "line 2: has no lanes (list), which TuSimple's"),
        ({"classes": 1}, "line 2: classes needs one class for each of"),
    ],
)
def test_a_bad_picture_is_refused_with_its_line(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1), {**entry(2), **change}])
    assert message in whats_wrong(path)


def test_a_camera_that_sees_only_sky_where_the_lines_are_is_refused(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1)])
    up = Camera(
        width=1280, height=720, fx=1040, fy=1040, cx=640, cy=360, height_m=1.6, pitch_deg=40
    )
    message = whats_wrong(path, camera=up)
    assert "no line has two points on the road within 25 m ahead of this camera" in message
