"""A camera that was turned on real pictures, and no false alarm about those that were not."""

from __future__ import annotations

import pytest

from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from makers.camera import carnd, clips, drift, tusimple
from makers.camera._labels import read_labels
from tests.conftest import needs_compiler


@needs_compiler
@pytest.mark.parametrize("name", ["ml", "mc"])
@pytest.mark.parametrize("away", [-1.0, 1.0])
def test_a_camera_turned_by_a_degree_corrects_itself_on_real_stills(name: str, away: float) -> None:
    labels = tusimple.data_file()
    if labels is None:
        pytest.skip(f"stills: needs EGOLANE_DATA with {tusimple.FILE}")
    turned = drift.look_at(labels, drift.stills_of(labels), name, away)
    recall, precision = tusimple.recall_precision(turned.stills, 0.0)
    assert recall > 0.80
    assert precision > 0.80
    (line,) = turned.warned
    assert f"calibrated with pitch_deg {tusimple.CAMERA.pitch_deg + away:.2f}; the pitch is" in line
    # The road itself rises and falls by half a degree for dozens of these stills.
    assert (abs(turned.pitch_deg[5:]) < 0.6).all()


@needs_compiler
def test_good_calibrations_of_real_roads_are_not_warned_of() -> None:
    folder, labels, video = clips.data(), tusimple.data_file(), carnd.data()
    if folder is None or labels is None or video is None:
        pytest.skip("drives: needs EGOLANE_DATA with camera/carnd and camera/tusimple_*")
    camera = tusimple.CAMERA
    assert drift.warned_of(drift.stills_of(labels), camera, "ml") == []
    for frame in read_labels(folder / "labels.jsonl"):
        shown = read_pictures(open_source(folder / clips._name(frame)), camera)
        assert drift.warned_of(shown, camera, "ml") == []
    camera = carnd.camera_of(video)
    shown = read_pictures(open_source(video / "test_video.mp4"), camera)
    assert drift.warned_of(shown, camera, "ml") == []
