"""Files of other lane detectors that cannot be used: one line each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from egolane_pgm.camera.model import Camera
from tests.kits.image_line_files import (
    ROWS,
    culane,
    entry,
    openlane,
    read,
    tusimple,
    whats_wrong,
)

# --- refused -------------------------------------------------------------------------------------


def test_broken_json_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1), entry(2)])
    path.write_text(path.read_text()[:-40])
    assert f"{path}: line 2: is not JSON" in whats_wrong(path)
    folder = openlane(tmp_path / "o", [1, 2])
    (folder / "2.json").write_text("{")
    assert f"{folder}/2.json: is not JSON" in whats_wrong(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lanes": [[1.0, 2.0]]}, f"line 2: lane 1 has 2 values for {len(ROWS)} h_samples"),
        ({"lanes": [["x"] * len(ROWS)]}, "line 2: lane 1 is not a list of numbers"),
        ({"lanes": {}}, "line 2: raw_file must be a text and lanes a list of lists"),
        ({"h_samples": [float("nan")] * len(ROWS)}, "h_samples has a number that is not finite"),
        ({"classes": [1]}, "line 2: classes needs one class for each of 3 lanes"),
        ({"classes": [1, 99, 1]}, "line 2: lane 2 has class 99, not one of 0 to 20"),
        ({"raw_file": "clips/0313-1/b/20.jpg"}, "line 2: is of another drive (clips/0313-1/b)"),
        ({"raw_file": "clips/0313-2/2/20.jpg"}, "line 2: is of another drive (clips/0313-2) than"),
        ({"raw_file": "clips/0313-1/1/20.jpg"}, "line 2: frame 1 is there twice"),
        ({"h_samples": [row * 4 for row in ROWS]}, "reaches down to row 2840, the camera's"),
    ],
)
def test_a_bad_picture_is_refused_with_its_line(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1), {**entry(2), **change}])
    assert said in whats_wrong(path)


def test_a_missing_key_is_refused_with_its_line(tmp_path: Path) -> None:
    without = entry(2)
    del without["h_samples"]
    path = tusimple(tmp_path / "a.jsonl", [entry(1), without])
    assert "line 2: has no h_samples, which TuSimple's format needs" in whats_wrong(path)


def test_a_picture_without_a_number_is_refused(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1, raw_file="a/b.jpg")])
    assert "'b' has no frame number in it" in whats_wrong(path)


def test_openlane_in_the_wrong_reader_is_told(tmp_path: Path) -> None:
    folder = openlane(tmp_path / "o", [1])
    said = whats_wrong(folder / "1.json")
    assert "line 1: has lane_lines: that is OpenLane's, format: openlane" in said
    assert len(read(folder / "1.json", format="openlane")) == 1


def test_files_with_nothing_in_them_are_refused(tmp_path: Path) -> None:
    empty = tusimple(tmp_path / "a.jsonl", [])
    assert whats_wrong(empty) == f"{empty}: no frame in it"
    (tmp_path / "d").mkdir()
    said = whats_wrong(tmp_path / "d", format="culane")
    assert said.endswith("no file *.lines.txt in it")
    assert "no file *.json in it" in whats_wrong(tmp_path / "d", format="openlane")
    said = whats_wrong(tmp_path / "d")
    assert "a folder without lines (*.lines.txt, *.json); pictures need a detector" in said
    culane(tmp_path / "d" / "drive", [1])
    said = whats_wrong(tmp_path / "d", format="culane")
    assert said.endswith(f"name one drive's folder, e.g. {tmp_path / 'd' / 'drive'}")


def test_odd_culane_files_are_refused(tmp_path: Path) -> None:
    folder = culane(tmp_path / "c", [1, 2])
    file = folder / "00002.lines.txt"
    for text, said in (
        ("1 2\n3 4 5\n", "line 2: 3 numbers are no pairs"),
        ("1 x\n", "line 1: could not convert string to float: 'x'"),
        ("1 nan\n", "line 1: a coordinate is not finite"),
    ):
        file.write_text(text)
        assert f"{file}: {said}" in whats_wrong(folder)
    file.rename(folder / "1.lines.txt")
    (folder / "1.lines.txt").write_text("")
    assert "frame 1 is there twice" in whats_wrong(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"category": 77}, "unknown category 77 (known: 0, 1, 2,"),
        ({"category": [1]}, "unknown category [1]"),
        ({"attribute": 9}, "unknown attribute 9 (known: 0 to 4)"),
        ({"uv": [[1, 2], [3]]}, "2 u for 1 v"),
        ({"uv": [1, 2, 3]}, "uv needs a list of u and a list of v"),
        ({"uv": [["a"], [1]]}, "u is not a list of numbers"),
    ],
)
def test_an_odd_openlane_line_is_refused(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    folder = openlane(tmp_path / "o", [1])
    content = json.loads((folder / "1.json").read_text())
    content["lane_lines"][1].update(change)
    (folder / "1.json").write_text(json.dumps(content))
    assert f"{folder}/1.json: lane_lines 2: {said}" in whats_wrong(folder)


def test_a_camera_that_sees_only_sky_where_the_lines_are_is_refused(tmp_path: Path) -> None:
    path = tusimple(tmp_path / "a.jsonl", [entry(1)])
    up = Camera(
        width=1280, height=720, fx=1040, fy=1040, cx=640, cy=360, height_m=1.6, pitch_deg=40
    )
    said = whats_wrong(path, camera=up)
    assert "no line has two points on the road within 25 m ahead of this camera" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"valid": "allways"}, "valid: 'allways' is not one of hysteresis, always (did you mean"),
        ({"frame_step": 0}, "frame_step: 0 is not a whole number from 1 up"),
        ({"frame_step": 2}, "frame 1 is no multiple of frame_step 2"),
        ({"frame_rate": 0}, "frame_rate 0 must be greater than 0"),
        ({"ahead_m": 300}, "ahead_m: 300 is not between 0 and 25 m"),
        ({"ahead_m": "far"}, "ahead_m: 'far' is not a number"),
        ({"continuous": "all"}, "continuous: 'all' is not a list of classes, 0 to 20"),
    ],
)
def test_options_out_of_range_are_refused(
    tmp_path: Path, options: dict[str, Any], said: str
) -> None:
    assert said in whats_wrong(tusimple(tmp_path / "a.jsonl", [entry(1)]), **options)
