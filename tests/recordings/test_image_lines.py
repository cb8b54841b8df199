"""What other lane detectors write: TuSimple's, CULane's and OpenLane's formats as recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.camera.model import road_to_image
from egolane_pgm.recordings.image_lines import (
    ImageLine,
    frame_numbers,
    offset_of,
    persistence,
)
from egolane_pgm.recordings.table import read_table
from egolane_pgm.results import read_result
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused, write_experiment
from tests.kits.image_line_files import (
    CAMERA,
    OFFSETS,
    ROWS,
    culane,
    entry,
    openlane,
    read,
    saved_camera,
    tusimple,
)


def test_tusimple_lines_get_their_offsets_at_the_car_from_left_to_right(tmp_path: Path) -> None:
    shuffled = [entry(k, OFFSETS[::-1], classes=[2, 1, 4]) for k in (7, 5, 6)]
    log = read(tusimple(tmp_path / "a.jsonl", shuffled))
    assert log.frame_id.tolist() == [5, 6, 7]
    np.testing.assert_allclose(log.time_s, [0.5, 0.6, 0.7])
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (3, 1)), atol=0.01)
    assert log.is_continuous.tolist() == [[True, False, True]] * 3


def test_culane_and_openlane_folders_give_the_same_offsets(tmp_path: Path) -> None:
    log = read(culane(tmp_path / "c", range(0, 90, 30)), frame_step=30)
    assert log.frame_id.tolist() == [0, 1, 2]
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (3, 1)), atol=0.01)
    assert not log.is_continuous.any()
    first = 152268801497018700  # tens of nanoseconds
    stamps = [first, first + 10_020_000, first + 30_010_000]
    log = read(openlane(tmp_path / "o", stamps))
    assert log.frame_id.tolist() == [0, 1, 3]
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (3, 1)), atol=0.01)
    assert log.is_continuous.tolist() == [[True, False, True]] * 3


def test_which_classes_are_continuous_is_an_option(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1, classes=[6, 1, 2])])
    assert read(path).is_continuous.tolist() == [[False, False, True]]
    assert read(path, continuous=[6]).is_continuous.tolist() == [[True, False, False]]


def test_a_picture_without_lines_is_a_frame_without_lines(tmp_path: Path) -> None:
    absent = {"raw_file": "clips/0313-1/3/20.jpg", "lanes": [[-2] * len(ROWS)], "h_samples": ROWS}
    log = read(tusimple(tmp_path / "a.jsonl", [entry(2), absent, entry(4)]))
    assert np.isfinite(log.offset_m).sum(axis=1).tolist() == [3, 0, 3]
    folder = culane(tmp_path / "c", [1, 3])
    (folder / "00002.lines.txt").write_text("\n")
    assert np.isfinite(read(folder).offset_m).sum(axis=1).tolist() == [3, 0, 3]


def test_a_clip_is_numbered_by_its_folder_and_a_picture_by_its_name(tmp_path: Path) -> None:
    for names in (
        ["clips/0313-1/40/20.jpg", "clips/0313-1/7/20.jpg"],
        ["drive2/frame_00007.jpg", "drive2/frame_00040.jpg"],
        ["40.png", "7.png"],
    ):
        log = read(tusimple(tmp_path / "a.jsonl", [entry(0, raw_file=name) for name in names]))
        assert log.frame_id.tolist() == [7, 40]


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=1), st.floats(-0.03, 0.03))
def test_an_offset_comes_back_whatever_the_heading(offsets: list[float], heading: float) -> None:
    x = np.linspace(5, 45, 30)
    u, v = road_to_image(CAMERA, x, offsets[0] + heading * x)
    assert offset_of(ImageLine(u, v), CAMERA) == pytest.approx(offsets[0], abs=0.02)
    there = offset_of(ImageLine(u, v), CAMERA, 10.0)
    assert there == pytest.approx(offsets[0] + 10 * heading, abs=0.02)


def test_a_bend_is_not_taken_for_an_offset() -> None:
    x = np.linspace(5, 50, 40)
    u, v = road_to_image(CAMERA, x, 1.8 + x**2 / 2 / 800)
    assert offset_of(ImageLine(u, v), CAMERA) == pytest.approx(1.8, abs=0.05)


def test_a_line_seen_only_far_ahead_or_above_the_horizon_has_no_offset() -> None:
    far = np.linspace(30, 60, 10)
    assert np.isnan(offset_of(ImageLine(*road_to_image(CAMERA, far, 0 * far)), CAMERA))
    sky = ImageLine(np.array([600.0, 610.0, 620.0]), np.array([20.0, 50.0, 90.0]))
    assert np.isnan(offset_of(sky, CAMERA))


def test_points_above_the_horizon_are_left_out(tmp_path: Path) -> None:
    high = entry(1, [1.5])
    high["h_samples"] = [10, 20, *ROWS]
    high["lanes"] = [[500, 900, *high["lanes"][0]]]
    assert read(tusimple(tmp_path / "a.jsonl", [high])).offset_m[0, 0] == pytest.approx(
        1.5, abs=0.01
    )


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


def test_a_line_missed_for_a_moment_stays_valid() -> None:
    seen = [[1.8]] * 10 + [[]] * 3 + [[1.8]] * 2
    lri, valid = persistence(rows(*seen), np.arange(len(seen)) / 10)
    assert lri[13].tolist() == [7.0]
    assert valid[13].all()


def test_lines_are_followed_as_they_move_and_new_ones_begin_at_one() -> None:
    offsets = [[-1.8 + 0.1 * k, 1.8 + 0.1 * k] for k in range(12)]
    offsets[11] = [-4.3, *offsets[11]]
    lri, valid = persistence(rows(*offsets), np.arange(12) / 10)
    assert lri[11].tolist() == [1.0, 10.0, 10.0]
    assert valid[11].tolist() == [False, True, True]


def test_missing_frames_are_no_misses_but_after_a_second_everything_is_new() -> None:
    ids = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 12, 40, 41])
    lri, valid = persistence(rows(*[[1.8]] * len(ids)), ids / 10)
    assert lri[9].tolist() == [10.0]
    assert valid[9].all()
    assert [lri[10].tolist(), lri[11].tolist()] == [[1.0], [2.0]]
    assert not valid[10].any()


@given(
    st.lists(
        st.lists(st.floats(-8, 8), max_size=5).map(sorted),
        min_size=1,
        max_size=30,
    ),
    st.floats(0.01, 2),
)
def test_lri_is_between_one_and_ten_and_valid_needs_half_of_it(
    offsets: list[list[float]], gap: float
) -> None:
    lri, valid = persistence(rows(*offsets), np.arange(len(offsets)) * gap)
    for at, flags, row in zip(lri, valid, offsets, strict=True):
        assert len(at) == len(flags) == len(row)
        assert ((at >= 1) & (at <= 10)).all()
        assert (at[flags] >= 5).all()


def test_lines_of_a_trusted_source_are_valid_at_once(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(20), entry(40)])
    log = read(path)
    assert not log.is_valid.any()
    log = read(path, valid="always", frame_step=20)
    assert log.frame_id.tolist() == [1, 2]
    assert log.is_valid.all()
    assert (log.lri == 10).all()


def test_time_stamps_become_frames_of_the_frame_rate() -> None:
    assert frame_numbers(["1492626270684175793", "1492626271684175793"], 20, "x") == [0, 20]
    assert frame_numbers(["1522688014970", "1522688015070"], 10, "x") == [0, 1]
    assert frame_numbers(["a_12", "b7_13"], 10, "x") == [12, 13]
    with pytest.raises(InputError, match="x: 'left' has no frame number"):
        frame_numbers(["left"], 10, "x")
    with pytest.raises(InputError, match=r"digits, neither counts nor one kind of time stamp"):
        frame_numbers(["1492626270684175793", "12"], 10, "x")


def test_labels_are_converted_and_run_like_any_recording(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.jsonl", [entry(k, classes=[4, 1, 1]) for k in range(30)])
    camera = saved_camera(tmp_path)
    done("convert", labels, tmp_path / "a.parquet", "--camera", camera)
    log = read_table(tmp_path / "a.parquet")
    np.testing.assert_allclose(log.offset_m, np.tile(OFFSETS, (30, 1)), atol=0.01)
    assert log.lri[-1].tolist() == [10, 10, 10]
    made = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    experiment = write_experiment(tmp_path / "e.yaml", ground_truth=None, **made)
    words = ["--recording", labels, "--camera", camera, "--no-figures", "--out", tmp_path / "r"]
    done("run", experiment, *words)
    by_command = read_result(tmp_path / "r")
    recording = {"path": "a.jsonl", "format": "tusimple", "camera": "cam.yaml"}
    write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None, **made)
    done("run", tmp_path / "e.yaml", "--no-figures", "--out", tmp_path / "r2")
    by_yaml = read_result(tmp_path / "r2")
    np.testing.assert_array_equal(by_command.marginals["Lane"], by_yaml.marginals["Lane"])
    # A continuous line two to the left: the car is in lane 2.
    assert by_yaml.assigned_lane[-1] == 2


def test_a_folder_of_labels_is_run_and_its_result_can_be_run_again(tmp_path: Path) -> None:
    folder = culane(tmp_path / "drive", range(12))
    camera, out = saved_camera(tmp_path), tmp_path / "r"
    experiment = write_experiment(tmp_path / "e.yaml", ground_truth=None)
    words = ["--camera", camera, "--no-figures", "--out", out]
    done("run", experiment, "--recording", folder, *words)
    data = read_result(out).run["data"][0]
    assert (data["path"], data["files"]) == (str(folder), 12)
    done("run", out / "experiment.yaml", "--no-figures", "--out", tmp_path / "again")
    (folder / "00003.lines.txt").write_text("")
    done("run", out / "experiment.yaml", "--no-figures", "--out", tmp_path / "changed")
    sums = [read_result(tmp_path / r).run["data"][0]["sha256"] for r in ("r", "again", "changed")]
    assert sums[0] == sums[1] != sums[2]


def test_options_of_the_format_are_given_in_the_yaml(tmp_path: Path) -> None:
    tusimple(tmp_path / "a.jsonl", [entry(k) for k in (20, 40, 60)])
    saved_camera(tmp_path)
    recording: dict[str, Any] = {"path": "a.jsonl", "camera": "cam.yaml"}
    recording["options"] = {"valid": "always", "frame_step": 20}
    path = write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    out = tmp_path / "r"
    done("run", path, "--no-figures", "--out", out)
    assert read_result(out).frame_id.tolist() == [1, 2, 3]
    recording["options"] = {"valed": "always"}
    write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    said = refused("run", path, "--no-figures", "--out", tmp_path / "r2")
    assert said.endswith("format tusimple has no option 'valed' (did you mean 'valid'?)")


def test_lines_in_pixels_without_a_camera_are_refused(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.jsonl", [entry(1)])
    said = refused("convert", labels, tmp_path / "a.csv")
    assert said.startswith(f"{labels}: its lines are in pixels: name the camera's YAML file")
    assert not (tmp_path / "a.csv").exists()
    said = refused("convert", labels, tmp_path / "a.csv", "--camera", tmp_path / "none.yaml")
    assert "none.yaml: cannot be read: No such file" in said
    experiment = write_experiment(
        tmp_path / "e.yaml", recording={"path": "a.jsonl"}, ground_truth=None
    )
    said = refused("validate", experiment)
    assert said == f"{experiment}: recording.camera: is missing; the lines of a.jsonl are in pixels"
    said = refused("convert", labels, tmp_path / "b.jsonl", "--camera", saved_camera(tmp_path))
    assert said == f"{tmp_path / 'b.jsonl'}: a recording is written as .csv, .parquet or .bag"


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("frame_rate=abc", "frame_rate: 'abc' is not a number"),
        ("frame_rate=true", "frame_rate: True is not a number"),
        ("frame_rate=.nan", "frame_rate nan must be greater than 0"),
        ("frame_rate=.inf", "frame_rate inf must be greater than 0"),
        ("camera=5", "camera: 5 is not the name of a camera's YAML file"),
        ("camera={fx: 3}", "camera: {'fx': 3} is not the name of a camera's YAML file"),
        ("format=culane", "format tusimple has no option 'format'"),
        ("path=x", "format tusimple has no option 'path'"),
    ],
)
def test_an_option_of_another_kind_is_refused(labels: Path, setting: str, said: str) -> None:
    assert said in refused("convert", labels, labels.with_name("a.csv"), "--set", setting)
    assert not labels.with_name("a.csv").exists()


def test_a_line_far_beside_the_picture_is_refused(labels: Path) -> None:
    first = json.loads(labels.read_text().splitlines()[0])
    first["lanes"][1] = [1e18] * len(first["h_samples"])
    labels.write_text(json.dumps(first) + "\n")
    said = refused(
        "convert", labels, labels.with_name("a.csv"), "--camera", labels.with_name("cam.yaml")
    )
    assert said.startswith(f"{labels}: line 1: a line reaches column 1e+18, the camera's pictures")
