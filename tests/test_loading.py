"""An experiment with a detector, run on other pictures: what of its YAML is taken along."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from egolane_pgm.drive import with_recording
from egolane_pgm.results import read_result

from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused, rewritten, short_drive
from tests.kits.synthetic_road import images, write_pictures, write_place, write_video

N_FRAMES = 6


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with drive.avi, cam.yaml, run.yaml and the same pictures in pictures/."""
    write_place(tmp_path, N_FRAMES)
    write_pictures(tmp_path / "pictures", images(N_FRAMES))
    return tmp_path


def seen(place: Path, **recording: Any) -> Experiment:
    changes = {f"recording__{key}": value for key, value in recording.items()}
    parameters = {"recording__detector_parameters__lri_frames": 7, **changes}
    return load_experiment(rewritten(place / "run.yaml", place / "seen.yaml", **parameters))


def taken(experiment: Experiment, recording: object, detector: str | None = None) -> Any:
    return with_recording(experiment, str(recording), None, None, detector=detector).recording


@pytest.mark.parametrize("other", ["pictures", "pictures/*.png", "pictures/0.png", "other.mkv"])
@pytest.mark.parametrize("own", ["drive.avi", "pictures", "pictures/*.png"])
def test_detector_and_camera_go_along_to_every_kind_of_pictures(
    place: Path, own: str, other: str
) -> None:
    recording = taken(seen(place, path=own), place / other)
    assert (recording.detector, recording.camera) == ("ml", "cam.yaml")
    assert recording.detector_parameters == {"lri_frames": 7}
    assert recording.path == str(place / other)


@pytest.mark.parametrize("own", ["drive.avi", "pictures"])
def test_recordings_of_lines_need_no_detector_and_get_none(place: Path, own: str) -> None:
    (place / "labels").mkdir()
    (place / "labels" / "0.mcap").write_text("")
    for other in ("lines.csv", "a.bag", "labels"):
        recording = taken(seen(place, path=own), place / other)
        assert (recording.detector, recording.camera) == (None, None)
        assert recording.detector_parameters == {}


def test_a_folder_of_both_is_asked_about(place: Path) -> None:
    (place / "pictures" / "0.mcap").write_text("")
    with pytest.raises(InputError, match=r"has pictures and lines \(0\.mcap, \.\.\.\)"):
        taken(seen(place), place / "pictures")
    assert taken(seen(place), place / "pictures", "ml").detector_parameters == {"lri_frames": 7}
    given = ["--recording", place / "pictures", "--set", "recording.detector=null"]
    assert "pictures: cannot be read as a bag" in refused("run", place / "run.yaml", *given)


def test_a_folder_of_recordings_is_not_taken_for_a_drive(place: Path) -> None:
    (place / "bags").mkdir()
    (place / "bags" / "a.bag").touch()
    said = refused("run", place / "run.yaml", "--recording", place / "bags")
    assert "bags: is a folder of recordings; name one of them" in said
    (place / "none").mkdir()
    said = refused("run", place / "run.yaml", "--recording", place / "none")
    assert "none: has no pictures" in said


def test_a_folder_of_pictures_gives_what_the_video_of_them_gives(place: Path) -> None:
    write_video(place / "exact.avi", images(N_FRAMES), four="PNG ")
    logs = {}
    for other in ("pictures", "pictures/*.png", "exact.avi"):
        out = place / "out"
        done("run", place / "run.yaml", "--recording", place / other, "--no-figures", "--out", out)
        logs[other] = read_result(out).marginals["Lane"]
    assert len(logs["pictures"]) == N_FRAMES
    np.testing.assert_array_equal(logs["pictures"], logs["pictures/*.png"])
    np.testing.assert_array_equal(logs["pictures"], logs["exact.avi"])


def test_lines_are_read_where_the_experiment_looks_at_pictures(place: Path) -> None:
    write_table(place / "lines.csv", short_drive().log)
    words = ["--recording", place / "lines.csv", "--no-figures", "--out", place / "out"]
    assert "150 frames" in done("run", place / "run.yaml", *words).stdout
