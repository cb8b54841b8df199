"""Videos: `egolane plot --out x.mp4`."""

from __future__ import annotations

import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import LaneTruth
from egolane_pgm.vision import video
from egolane_pgm.vision.camera.model import road_to_image, write_camera
from egolane_pgm.vision.camera.writing import video_writer
from egolane_pgm.vision.video import bar_boxes, layout
from tests.kits.drawn_frames import (
    CAMERA,
    OFFSETS,
    around,
    drawn,
    is_colour,
    road,
    scene,
)
from tests.kits.drives import command, done, refused

#: A detector that says the same of every picture.
DETECTOR = """
    import numpy as np
    from egolane_pgm.vision.detectors import FrameLines
    STEREO = False
    def start(camera, parameters):
        def step(picture):
            {}
            shape = np.zeros((3, 4))
            shape[:, 0] = -1.9, 1.6, 5.2
            yes = np.ones(3, dtype=bool)
            return FrameLines(shape, yes, np.array([True, False, False]), np.full(3, 10.0))
        return step
"""


def frames_of(path: Path) -> list[np.ndarray]:
    read = cv2.VideoCapture(str(path))
    images = []
    while True:
        is_there, image = read.read()
        if not is_there:
            return images
        images.append(image)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A folder with six pictures (`pictures/img_0010.png` ...), cam.yaml and fake.py."""
    (tmp_path / "pictures").mkdir()
    for k in range(10, 16):
        cv2.imwrite(str(tmp_path / "pictures" / f"img_{k:04d}.png"), road())
    write_camera(tmp_path / "cam.yaml", CAMERA)
    write_detector(tmp_path)
    return tmp_path


def write_detector(folder: Path, first: str = "pass") -> None:
    (folder / "fake.py").write_text(textwrap.dedent(DETECTOR.format(first)))


def run(drive: Path, *more: object) -> Path:
    """A result of the detector on the pictures."""
    given = ["--camera", drive / "cam.yaml", "--detector", drive / "fake.py", "--n-lanes", 3]
    done("run", drive / "pictures", *given, "--no-figures", "--out", drive / "out", *more)
    return drive / "out"


def test_a_video_has_as_many_frames_of_the_same_size(tmp_path: Path) -> None:
    places = layout(CAMERA)
    image = drawn(scene([0, 1], 2))
    with video_writer(tmp_path / "a.mp4", 12.5, places.size) as write:
        for _ in range(7):
            write(image)
    found = frames_of(tmp_path / "a.mp4")
    assert len(found) == 7
    assert found[0].shape == image.shape
    assert np.abs(found[3].astype(int) - image).mean() < 6
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == 12.5
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_a_result_is_drawn_on_its_pictures_with_the_truth(drive: Path) -> None:
    truth = LaneTruth(np.arange(10, 16), np.full(6, 2), np.zeros(6, dtype=bool))
    write_ground_truth(drive / "truth.txt", truth)
    rate = ["--set", "recording.frame_rate=20"]
    result = run(drive, "--ground-truth", drive / "truth.txt", *rate)
    assert done("plot", result, "--out", drive / "a.mp4").stdout == f"{drive / 'a.mp4'}\n"
    found = frames_of(drive / "a.mp4")
    assert len(found) == 6
    assert cv2.VideoCapture(str(drive / "a.mp4")).get(cv2.CAP_PROP_FPS) == 20
    places = layout(CAMERA)
    assert found[0].shape == (places.size[1], places.size[0], 3)
    u, v = road_to_image(CAMERA, 7.0, OFFSETS[0])
    near = around(found[0], float(u), float(v))
    assert any(is_colour(p, video.CONTINUOUS, 70) for p in near)
    left, upper, _, lower = bar_boxes(places, 3)[1]
    assert is_colour(found[-1][(upper + lower) // 2, left - 3], video.TRUTH, 70)
    done("plot", result, "--out", drive / "b.mp4", "--frames", 11, 13)
    assert len(frames_of(drive / "b.mp4")) == 3


def test_frames_before_an_interruption_are_kept(drive: Path) -> None:
    result = run(drive)
    write_detector(drive, "if picture.frame_id == 13: raise KeyboardInterrupt")
    stopped = command("plot", result, "--out", drive / "out.mp4")
    assert stopped.exit_code == 130
    assert stopped.stderr == (
        f"egolane: interrupted; 3 frames are in {drive / 'out.mp4'}; the same command begins anew\n"
    )
    assert len(frames_of(drive / "out.mp4")) == 3


def test_a_picture_of_another_size_ends_the_video_after_those_before_it(drive: Path) -> None:
    result = run(drive)
    cv2.imwrite(str(drive / "pictures" / "img_0012.png"), road()[:-8])
    said = refused("plot", result, "--out", drive / "out.mp4")
    assert "frame 12: the picture has 640x392 pixels, the camera was calibrated" in said
    assert said.endswith(f"; the 2 frames before are in {drive / 'out.mp4'}")


def test_a_result_without_pictures_is_refused(drive: Path) -> None:
    said = refused("plot", run(drive), "--out", drive / "a.mp4", "--frames", 90, 95)
    assert "has no frame from 90 to 95" in said
    result = drive / "result"
    done("run", "quickstart", "--set", "recording.frames=[0, 60]", "--no-figures", "--out", result)
    said = refused("plot", result, "--out", drive / "a.mp4")
    assert said.startswith(f"{result}: has no pictures to draw")
    assert not (drive / "a.mp4").exists()
