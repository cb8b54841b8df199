"""What cannot be known from some pictures is said in one line, with the cure."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.loading import load_experiment
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision.calibration.road_lines import calibrate_road
from egolane_pgm.vision.camera.model import write_camera
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.camera.pictures import open_source
from egolane_pgm.vision.detectors.pictures import lanes_seen
from egolane_pgm.vision.detectors.runner import detect, find_detector
from tests.kits.synthetic_road import (
    CAMERA,
    PAIR,
    THREE,
    Paint,
    drive,
    images,
    road,
    write_pictures,
)
from tests.kits.tiny_network import top_hat_file, write_answer


def calibrated(folder: Path, pictures: Sequence[Image]) -> list[str]:
    """The error, or else the warnings, of a calibration by these pictures."""
    source = open_source(write_pictures(folder / "p", pictures))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            calibrate_road(source)
        except InputError as error:
            return [str(error)]
    return [str(each.message) for each in caught]


def detected(name: str, pictures: Sequence[Picture], **given: object) -> list[str]:
    """The warnings of a detector."""
    camera = PAIR if pictures[0].right is not None else CAMERA
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        list(detect(find_detector(name, given, "detector"), camera, pictures))
    return [str(each.message) for each in caught]


def swaying() -> list[Image]:
    """Pictures of a camera that nods by 1.6 degrees."""
    pitch = CAMERA.pitch_deg + np.linspace(-1.6, 1.6, 8)
    cameras = [replace(CAMERA, pitch_deg=each) for each in pitch.tolist()]
    return [road(THREE, 2.7 * k, camera=camera) for k, camera in enumerate(cameras)]


@pytest.mark.parametrize(
    ("pictures", "message"),
    [
        (images(8), ""),
        (swaying(), "doubtful: the lines of 8 pictures meet in points that differ by"),
        (images(1), "doubtful: only 2 of 2 gaps between lines are as wide as most"),
        (
            [road((Paint(-0.45), Paint(0.5)))] * 2,
            "no two neighbouring lines are one lane of 3.5 m apart",
        ),
        ([each[::-1, ::-1] for each in images(4)], "the pictures are upside down: turn them"),
    ],
)
def test_a_calibration_is_doubted(tmp_path: Path, pictures: list[Image], message: str) -> None:
    said = calibrated(tmp_path, pictures)
    assert len(said) == bool(message)
    assert all(each.startswith(f"{tmp_path / 'p'}: {message}") for each in said)


@pytest.mark.parametrize(("left", "is_doubted"), [(Paint(-5.2), True), (Paint(-3.3), False)])
def test_a_line_a_lane_beyond_the_edge_is_doubted_once(left: Paint, is_doubted: bool) -> None:
    lines = (left, Paint(-1.7), Paint(1.8, 4.0, 12.0))
    said = [text for text in detected("ml", drive(80, lines)) if "a lane beyond" in text]
    assert len(said) == is_doubted


@pytest.mark.parametrize(
    ("mark", "message"), [(0.0, "no line was found"), (1.0, "the car drives on a line")]
)
def test_a_network_that_sees_nothing_or_the_road_is_doubted_with_the_layouts_that_fit(
    tmp_path: Path, mark: float, message: str
) -> None:
    mask = np.zeros((1, 2, 270, 480))
    rows, columns = np.mgrid[:270, :480]
    mask[0, 1] = mark * (np.abs(columns - 240) < 1.3 * (rows - 108))
    path = write_answer(tmp_path, mask, size=[480, 270], layout="lanes", classes=2)
    (said,) = detected("network", drive(21), network=str(path))
    assert f"doubtful: {message}" in said
    assert "layout lanes fits" in said
    assert not detected("network", drive(21), network=str(top_hat_file(480, 270)))


def test_pairs_that_do_not_match_are_doubted() -> None:
    rng = np.random.default_rng(0)
    shape = (21, 2, CAMERA.height, CAMERA.width, 3)
    noise = rng.integers(0, 255, shape, dtype=np.uint8)
    said = detected("sl", [Picture(k, *pair) for k, pair in enumerate(noise)])
    assert [text for text in said if "no road plane was found" in text]
    assert [text for text in said if "most of the road has no match" in text]


@pytest.mark.parametrize(
    ("seconds", "n_lanes", "is_doubted"), [(70, 2, True), (70, 3, False), (50, 2, False)]
)
def test_another_number_of_lanes_between_continuous_lines_is_doubted_after_a_minute(
    tmp_path: Path, seconds: int, n_lanes: int, is_doubted: bool
) -> None:
    write_camera(tmp_path / "cam.yaml", CAMERA)
    recording = {"path": "x.mp4", "camera": str(tmp_path / "cam.yaml"), "detector": "ml"}
    experiment = load_experiment({"name": "a", "n_lanes": n_lanes, "recording": recording})
    ids = np.arange(10 * seconds)
    row, yes = np.repeat(ids, 2), np.ones(2 * len(ids), dtype=bool)
    offset = np.tile([-5.5, 5.2], len(ids))
    log = LineLog.from_rows(ids, 10.0, row, offset, yes, yes, 10.0 * yes)
    said = list(lanes_seen(log, experiment))
    assert len(said) == is_doubted
    assert all("n_lanes is 2, but between two continuous lines 3 lanes were" in x for x in said)
