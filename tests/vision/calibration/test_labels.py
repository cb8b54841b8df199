"""The labels and pictures that cameras are calibrated from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.calibration.labels import (
    check_size,
    label_picture,
    line_points,
    read_labels,
    size_of_pictures,
)
from egolane_pgm.vision.camera.pictures import files_matching


def picture(path: Path, width: int = 64, height: int = 48) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.zeros((height, width, 3), np.uint8))
    return path


def label(rows: list[int] | None = None, **names: object) -> dict[str, Any]:
    rows = [20, 30, 40] if rows is None else rows
    return {"lanes": [[10, 11, -2]], "h_samples": rows, **names}


def test_the_points_of_a_label_are_column_and_row(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    path.write_text(json.dumps(label(raw_file="a.png")) + "\n")
    ((points,),) = [line_points(frame) for frame in read_labels(path)]
    assert points.tolist() == [[10, 20], [11, 30]]


def test_every_label_is_checked_when_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    good = json.dumps(label(raw_file="a.png"))
    bad = json.dumps({**label(raw_file="b.png"), "lanes": [[1]]})
    path.write_text(f"{good}\n{bad}\n")
    with pytest.raises(InputError, match=r"labels\.jsonl: line 2"):
        read_labels(path)
    path.write_text("")
    with pytest.raises(InputError, match=r"labels\.jsonl: holds no labelled frame"):
        read_labels(path)


def test_classes_are_not_needed_and_may_be_any(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    path.write_text(json.dumps(label(raw_file="a.png", classes=[99])) + "\n")
    (frame,) = read_labels(path)
    assert [points.tolist() for points in line_points(frame)] == [[[10, 20], [11, 30]]]


def test_the_picture_of_a_label_is_the_one_that_is_there(tmp_path: Path) -> None:
    labels = tmp_path / "labels.jsonl"
    own, raw = picture(tmp_path / "own.png"), picture(tmp_path / "clips" / "raw.png")
    both = label(image="own.png", raw_file="clips/raw.png")
    assert label_picture(both, labels) == own
    own.unlink()
    assert label_picture(both, labels) == raw
    raw.unlink()
    with pytest.raises(InputError, match=r"own\.png: the image of a label is missing; give"):
        label_picture(both, labels)
    with pytest.raises(InputError, match=r"labels\.jsonl: a frame names no image; give its size"):
        label_picture(label(raw_file=7), labels)


def test_a_size_that_the_labels_contradict_is_refused(tmp_path: Path) -> None:
    labels = tmp_path / "labels.jsonl"
    picture(tmp_path / "b.png")
    # The first picture that is there tells it.
    frames = [label(raw_file="a.png"), label(raw_file="b.png")]
    check_size((64, 48), frames, labels)
    for size in ((48, 64), (64, 47), (65, 48)):
        with pytest.raises(InputError, match=rf"size: .*b\.png is 64x48, not {size[0]}x{size[1]}"):
            check_size(size, frames, labels)
    without = [label(raw_file="a.png"), label([20, 300, 310], raw_file="c.png")]
    check_size((640, 480), without, labels)
    with pytest.raises(InputError, match=r"reach down to row 300, below a picture of 640x240"):
        check_size((640, 240), without, labels)


def test_labelled_pictures_of_two_sizes_are_refused(tmp_path: Path) -> None:
    labels = tmp_path / "labels.jsonl"
    frames = [label(raw_file=f"{k}.png") for k in range(3)]
    for k in range(3):
        picture(tmp_path / f"{k}.png")
    assert size_of_pictures(frames, labels) == (64, 48)
    picture(tmp_path / "2.png", 48, 64)
    with pytest.raises(InputError, match=r"differ in size: .*0\.png 64x48, .*2\.png 48x64"):
        size_of_pictures(frames, labels)


def test_pictures_of_a_folder_or_a_pattern_are_sorted_and_folders_left_out(tmp_path: Path) -> None:
    paths = [picture(tmp_path / name) for name in ("c.png", "a.png", "b/x.png", "d.png", "b.png")]
    in_it = sorted(path for path in paths if path.parent == tmp_path)
    assert files_matching(str(tmp_path)) == in_it
    assert files_matching(str(tmp_path / "*")) == in_it
    assert files_matching(str(tmp_path / "**" / "*.png")) == sorted(paths, key=str)
    assert files_matching(str(tmp_path / "[ad].png")) == [tmp_path / "a.png", tmp_path / "d.png"]
    (tmp_path / "empty" / "inner").mkdir(parents=True)
    with pytest.raises(InputError, match=r"empty: no file matches; give a folder or a pattern"):
        files_matching(str(tmp_path / "empty"))


def test_the_name_of_a_folder_or_picture_may_look_like_a_pattern(tmp_path: Path) -> None:
    first, second = (
        picture(tmp_path / "drive[1]" / "a*.png"),
        picture(tmp_path / "drive1" / "b.png"),
    )
    assert files_matching(str(first.parent)) == [first]
    assert files_matching(str(first)) == [first]
    assert files_matching(str(tmp_path / "drive?" / "*.png")) == [second]
