"""Options that every format of other detectors has, and the ends of what a file may hold."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.camera.model import road_to_image
from egolane_pgm.recordings.image_lines import (
    ImageLine,
    frame_numbers,
    offset_of,
    persistence,
    points,
)
from egolane_pgm.recordings.openlane import CATEGORIES
from egolane_pgm.recordings.tusimple import entry_lines, read_tusimple
from egolane_pgm.types import InputError
from tests.kits.image_line_files import (
    CAMERA,
    OFFSETS,
    columns,
    culane,
    entry,
    openlane,
    read,
    tusimple,
)

WRITERS: dict[str, Callable[[Path, list[int]], Path]] = {
    "tusimple": lambda folder, ids: tusimple(folder / "labels.json", [entry(k) for k in ids]),
    "culane": lambda folder, ids: culane(folder / "culane", ids),
    "openlane": lambda folder, ids: openlane(folder / "openlane", ids),
}
every_format = pytest.mark.parametrize("name", WRITERS)


@every_format
def test_frames_valid_flags_and_where_it_is_measured_are_as_asked(
    name: str, tmp_path: Path
) -> None:
    path = WRITERS[name](tmp_path, [40, 10, 30])
    log = read(path, format=name, frame_step=10, frame_rate=4.0, valid="always", ahead_m=12.0)
    assert log.frame_id.tolist() == [1, 3, 4]
    np.testing.assert_allclose(log.time_s, [0.25, 0.75, 1.0])
    assert log.is_valid.all()
    assert (log.lri == 10).all()
    # The camera is turned to the right: a straight road passes it at the same offset everywhere.
    at_the_car = read(path, format=name, frame_step=10)
    assert not at_the_car.is_valid.any()
    np.testing.assert_allclose(at_the_car.offset_m[0], OFFSETS, atol=0.05)
    np.testing.assert_allclose(log.offset_m[0], OFFSETS, atol=0.05)


@every_format
def test_ahead_of_the_car_a_line_that_turns_away_is_further_off(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """y = offset + 0.02 x: 0.2 m more ten metres ahead."""
    far = np.geomspace(2, 400, 4000)[::-1]
    turned = {}
    for offset in OFFSETS:
        u, v = road_to_image(CAMERA, far, offset + 0.02 * far)
        turned[offset] = np.interp(range(300, 720, 10), v, u, left=-2, right=-2).tolist()
    monkeypatch.setattr("tests.kits.image_line_files.columns", turned.__getitem__)
    path = WRITERS[name](tmp_path, [1])
    here, ahead = (read(path, format=name, ahead_m=metres).offset_m[0] for metres in (0.0, 10.0))
    np.testing.assert_allclose(here, OFFSETS, atol=0.05)
    np.testing.assert_allclose(ahead - here, 0.2, atol=0.03)


def test_the_first_column_is_a_point_and_a_line_without_points_is_none() -> None:
    picture = {"lanes": [[0, -2, 7.5], [-2, -2, -2]], "h_samples": [400, 410, 420]}
    [line] = entry_lines(picture, "here")
    assert line.u.tolist() == [0, 7.5]
    assert line.v.tolist() == [400, 420]


@pytest.mark.parametrize(
    ("known", "is_good"), [(20, True), (21, False), (-1, False), (True, False)]
)
def test_classes_are_whole_numbers_up_to_twenty(known: Any, is_good: bool) -> None:
    picture = {"lanes": [[5, 6]], "h_samples": [400, 410], "classes": [known]}
    if is_good:
        assert entry_lines(picture, "here", frozenset({20}))[0].is_continuous
        return
    with pytest.raises(InputError, match=f"here: lane 1 has class {known}, not one of 0 to 20"):
        entry_lines(picture, "here")


@pytest.mark.parametrize("continuous", [[21], [-1], [2.0], "2", None])
def test_only_classes_can_be_continuous(tmp_path: Path, continuous: Any) -> None:
    path = WRITERS["tusimple"](tmp_path, [1])
    with pytest.raises(InputError, match="is not a list of classes, 0 to 20"):
        read(path, format="tusimple", continuous=continuous)


def test_empty_lines_of_a_file_are_passed_over(tmp_path: Path) -> None:
    path = WRITERS["tusimple"](tmp_path, [1, 2])
    path.write_text(path.read_text().replace("\n", "\n\n  \n"))
    assert len(read(path, format="tusimple")) == 2


def test_solid_lines_and_curbs_are_continuous_in_openlane(tmp_path: Path) -> None:
    solid = {2, 4, 5, 6, 8, 10, 11, 12, 20, 21}
    for category in CATEGORIES:
        path = openlane(tmp_path / str(category), [1], categories=(category,) * 3)
        log = read(path, format="openlane")
        assert log.is_continuous.tolist() == [[category in solid] * 3], category
    assert len(columns(OFFSETS[0])) == 42


def test_an_unknown_attribute_and_another_drive_are_refused_in_openlane(tmp_path: Path) -> None:
    path = openlane(tmp_path / "drive", [1, 2])
    content = json.loads((path / "2.json").read_text())
    (path / "2.json").write_text(json.dumps({**content, "file_path": "training/segment-8/2.jpg"}))
    with pytest.raises(InputError, match=r"2\.json: is of another drive \(training/segment-8\)"):
        read(path, format="openlane")
    for attribute, is_good in ((4, True), (5, False)):
        content["lane_lines"][0]["attribute"] = attribute
        (path / "2.json").write_text(json.dumps(content))
        if is_good:
            read(path, format="openlane")
            continue
        with pytest.raises(InputError, match="unknown attribute 5 "):
            read(path, format="openlane")


def test_a_line_far_outside_of_the_picture_is_of_another_camera(tmp_path: Path) -> None:
    picture = entry(1)
    picture["lanes"][0] = [*picture["lanes"][0][:-1], 30 * CAMERA.width]
    path = tusimple(tmp_path / "labels.json", [picture])
    with pytest.raises(InputError, match=r"a line reaches column 38400, .*have 1280"):
        read(path, format="tusimple")


# --- where a line passes the car -----------------------------------------------------------------


def seen_from(x: np.ndarray, y: np.ndarray, noise: np.ndarray | float = 0.0) -> ImageLine:
    u, v = road_to_image(CAMERA, x, y)
    return ImageLine(u + noise, v)


def test_a_bend_is_followed_to_where_offsets_are_measured() -> None:
    """y = 1.8 + 0.003 x^2 / 2."""
    x = np.linspace(6, 45, 30)
    line = seen_from(x, 1.8 + 0.003 * x * x / 2)
    for ahead_m in (0.0, 10.0, 20.0):
        right = 1.8 + 0.003 * ahead_m**2 / 2
        assert offset_of(line, CAMERA, ahead_m) == pytest.approx(right, abs=0.01)


def test_what_is_more_than_fifty_metres_ahead_does_not_count() -> None:
    x = np.linspace(6, 90, 60)
    line = seen_from(x, 1.8 + np.where(x > 50, (x - 50) * 0.2, 0))
    assert offset_of(line, CAMERA) == pytest.approx(1.8, abs=1e-6)


def test_far_points_are_less_exact_and_a_far_piece_is_not_drawn_out_wildly() -> None:
    rng = np.random.default_rng(0)

    def error(x: np.ndarray) -> float:
        """Of the offset, metres, with two pixels of noise."""
        offsets = [
            offset_of(seen_from(x, np.full(len(x), 1.8), rng.normal(0, 2, len(x))), CAMERA)
            for _ in range(100)
        ]
        return float(np.sqrt(np.mean((np.array(offsets) - 1.8) ** 2)))

    assert error(np.linspace(6, 45, 30)) < 0.025
    assert error(np.linspace(21, 25, 8)) < 0.5


# --- from picture to picture ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap_s", "moved_m", "lri"),
    [
        (0.1, 0.44, 2),  # 0.3 m, and 1.5 m for each second
        (0.1, 0.46, 1),
        (0.5, 1.04, 2),
        (0.5, 1.06, 1),
        (1.0, 0.0, 2),  # a second is not too long
        (1.1, 0.0, 1),
    ],
)
def test_how_far_and_how_long_a_line_is_followed(gap_s: float, moved_m: float, lri: int) -> None:
    rows = [np.array([1.0]), np.array([1.0 + moved_m])]
    found, _ = persistence(rows, np.array([0.0, gap_s]))
    assert found[1].tolist() == [lri]


def test_of_two_lines_near_an_earlier_one_the_nearer_continues_it() -> None:
    rows = [np.array([1.0]), np.array([0.9, 1.2]), np.array([0.9, 1.2])]
    found, _ = persistence(rows, np.arange(3) / 10)
    assert [row.tolist() for row in found] == [[1], [2, 1], [3, 2]]


@pytest.mark.parametrize(("missed", "is_valid"), [(5, True), (6, False)])
def test_half_of_the_last_ten_sightings_keep_a_line_valid(missed: int, is_valid: bool) -> None:
    rows = [np.array([1.0])] * 10 + [np.zeros(0)] * missed + [np.array([1.0])]
    found, valid = persistence(rows, np.arange(len(rows)) / 10)
    assert found[-1].tolist() == [10 - missed]
    assert valid[-1].tolist() == [is_valid]


# --- what is mixed up ----------------------------------------------------------------------------


def test_a_line_keeps_its_class_whatever_order_the_lines_are_in(tmp_path: Path) -> None:
    left, middle, right = OFFSETS
    picture = entry(1, (right, left, middle), classes=[2, 1, 1])
    log = read(tusimple(tmp_path / "labels.json", [picture]), format="tusimple")
    assert log.is_continuous.tolist() == [[False, False, True]]


def test_time_stamps_of_two_kinds_are_no_frame_numbers() -> None:
    with pytest.raises(InputError, match=r"frame numbers of \[13, 16\] digits"):
        frame_numbers(["1700000000000", "1700000000100000"], 10.0, "here")
    assert frame_numbers(["1700000000000", "1700000000100"], 10.0, "here") == [0, 1]


def test_true_is_no_coordinate() -> None:
    with pytest.raises(InputError, match="here: u is not a list of numbers"):
        points([1.0, True], "here", "u")
    assert points([1, 2.5], "here", "u").tolist() == [1, 2.5]


@pytest.mark.parametrize("frame_rate", [0.0, -10.0, float("nan"), float("inf")])
def test_a_frame_rate_that_is_none_is_refused(tmp_path: Path, frame_rate: float) -> None:
    path = WRITERS["tusimple"](tmp_path, [1])
    with pytest.raises(InputError, match=r"frame_rate \S+ must be"):
        read_tusimple(path, camera=CAMERA, frame_rate=frame_rate)
