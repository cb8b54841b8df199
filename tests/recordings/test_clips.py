"""Recordings of many clips: which pictures are one, and that each is run from the start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import InputError, LineLog, clip_slices
from tests.kits.image_line_files import (
    OFFSETS,
    ROWS,
    columns,
    entry,
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
    return [(str(log.clip[p.start]), log.frame_id[p].tolist()) for p in clip_slices(log.clip)]


def test_each_folder_of_the_official_test_labels_is_a_clip(tmp_path: Path) -> None:
    labels = [picture for clip in OFFICIAL for picture in pictures(clip, [20])]
    with pytest.warns(UserWarning, match="its 3 clips have fewer than 10 pictures"):
        log = read(tusimple(tmp_path / "test_label.json", labels))
    assert clips_of(log) == [(clip, [k]) for k, clip in enumerate(OFFICIAL)]
    # One picture cannot show that a line persists.
    assert log.is_valid.all()


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
    labelled = {"raw_file": f"{OFFICIAL[0]}/20.jpg", "lanes": lanes, "run_time": 10}
    nothing = {"raw_file": f"{OFFICIAL[1]}/20.jpg", "lanes": [], "run_time": 10}
    with pytest.warns(UserWarning, match="its 2 clips"):
        log = read(tusimple(tmp_path / "a.json", [labelled, nothing]))
    np.testing.assert_allclose(log.offset_m[0], OFFSETS, atol=0.02)
    assert np.isnan(log.offset_m[1]).all()
    with pytest.raises(InputError, match=r"line 1: lane 4 has 47 values for .* h_samples"):
        read(tusimple(tmp_path / "b.json", [{**labelled, "lanes": [*lanes, [1.0] * 47]}]))


@pytest.mark.parametrize(
    ("names", "clips"),
    [
        # Numbered folders of one picture each count the frames of a drive.
        (
            ["0313-1/60/20", "0313-1/62/20", "0313-2/7/20"],
            [("clips/0313-1", [0, 2]), ("clips/0313-2", [3])],
        ),
        # A numbered folder with several pictures is a clip.
        (
            ["0313-1/60/19", "0313-1/60/20", "0313-1/120/20"],
            [("clips/0313-1/60", [0, 1]), ("clips/0313-1", [2])],
        ),
    ],
)
def test_numbered_folders_are_frames_or_clips(
    tmp_path: Path, names: list[str], clips: list[tuple[str, list[int]]]
) -> None:
    rows = [entry(0, raw_file=f"clips/{name}.jpg") for name in names]
    with pytest.warns(UserWarning, match="its 2 clips"):
        log = read(tusimple(tmp_path / "a.json", rows))
    assert clips_of(log) == clips


def test_clips_are_refused_where_one_drive_is_needed(tmp_path: Path) -> None:
    labels = tusimple(tmp_path / "a.json", [p for c in OFFICIAL for p in pictures(c, range(12))])
    camera = saved_camera(tmp_path)
    with pytest.raises(InputError, match="has several clips; a written file holds one drive"):
        write_table(tmp_path / "a.csv", read_lines(labels, camera=camera))
