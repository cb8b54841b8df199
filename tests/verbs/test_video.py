"""The command `egolane video`: a drive drawn, as a video or as pictures."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import InputError, LaneTruth, LineLog
from egolane_pgm.vision import video
from egolane_pgm.vision.camera.model import road_to_image, write_camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.camera.pictures import open_source
from egolane_pgm.vision.camera.writing import frame_writer
from egolane_pgm.vision.video import bar_boxes, layout, with_recorded_lines
from tests.kits.drawn_frames import (
    CAMERA,
    OFFSETS,
    around,
    drawn,
    filled,
    is_colour,
    road,
    scene,
)
from tests.kits.drives import command, contents, done, refused, write_experiment
from tests.kits.synthetic_road import road as empty_road
from tests.kits.synthetic_road import write_pictures

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


def words(drive: Path, *more: object, n_lanes: int = 3, out: str = "out") -> list[object]:
    given = ["--detector", drive / "fake.py", "--n-lanes", n_lanes, "-o", drive / out]
    return ["video", drive / "pictures", "--camera", drive / "cam.yaml", *given, *more]


def test_a_video_has_as_many_frames_of_the_same_size(tmp_path: Path) -> None:
    places = layout(CAMERA)
    image = drawn(scene([0, 1], 2))
    with frame_writer(tmp_path / "a.mp4", 12.5, places.size) as write:
        for k in range(7):
            write(k, image)
    found = frames_of(tmp_path / "a.mp4")
    assert len(found) == 7
    assert found[0].shape == image.shape
    assert np.abs(found[3].astype(int) - image).mean() < 6
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == 12.5
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_what_was_written_is_kept_whatever_ends_the_drive(tmp_path: Path) -> None:
    image = drawn(scene([0, 1], 2))
    size = layout(CAMERA).size

    def interrupted() -> None:
        with frame_writer(tmp_path / "a.mp4", 10, size) as write:
            write(0, image)
            write(1, image)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(frames_of(tmp_path / "a.mp4")) == 2
    with pytest.raises(InputError), frame_writer(tmp_path / "a.mp4", 10, size):
        raise InputError("no picture")
    assert len(frames_of(tmp_path / "a.mp4")) == 2, "an earlier video is not overwritten by nothing"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_places_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    size = layout(CAMERA).size
    (tmp_path / "file").write_text("")
    (tmp_path / "d.mp4").mkdir()
    for target, said in (
        (tmp_path / "none" / "a.mp4", "a.mp4: cannot be written: no such folder"),
        (tmp_path / "a.avi", "a.avi: a video ends in .mp4; for PNG pictures name a folder"),
        (tmp_path / "file", "file: a video ends in .mp4; for PNG pictures name a folder"),
        (tmp_path / "file" / "b", "cannot be written"),
        (tmp_path / "d.mp4", "d.mp4: is a folder"),
    ):
        with pytest.raises(InputError) as caught, frame_writer(target, 10, size):
            pass
        assert said in str(caught.value)


def test_the_command_draws_pictures_named_by_their_frames(drive: Path) -> None:
    said = done(*words(drive, "--frames", 11, 14)).stdout
    assert said == f"{drive / 'out'}: 3 frames\n"
    files = sorted(p.name for p in (drive / "out").iterdir())
    assert files == ["frame_000011.png", "frame_000012.png", "frame_000013.png"]
    image = cv2.imread(str(drive / "out" / files[0]))
    places = layout(CAMERA)
    assert image.shape == (places.size[1], places.size[0], 3)
    u, v = road_to_image(CAMERA, 7.0, OFFSETS[0])
    assert any(is_colour(p, video.CONTINUOUS, 40) for p in around(image, float(u), float(v)))


def test_the_command_draws_a_video_of_a_video_with_the_truth(drive: Path) -> None:
    size = (CAMERA.width, CAMERA.height)
    with frame_writer(drive / "in.mp4", 20, size) as write:
        for k in range(5):
            write(k, road())
    truth = LaneTruth(np.arange(5), np.full(5, 2), np.zeros(5, dtype=bool))
    write_ground_truth(drive / "truth.txt", truth)
    line = words(drive, "--ground-truth", drive / "truth.txt", out="out.mp4")
    line[1] = drive / "in.mp4"
    done(*line)
    found = frames_of(drive / "out.mp4")
    assert len(found) == 5
    assert cv2.VideoCapture(str(drive / "out.mp4")).get(cv2.CAP_PROP_FPS) == 20
    left, upper, _, lower = bar_boxes(layout(CAMERA), 3)[1]
    assert is_colour(found[-1][(upper + lower) // 2, left - 3], video.TRUTH, 70)


def test_the_continuous_line_on_the_left_gives_the_leftmost_lane(drive: Path) -> None:
    for k in range(16, 60):
        cv2.imwrite(str(drive / "pictures" / f"img_{k:04d}.png"), road())
    done(*words(drive))
    image = cv2.imread(str(drive / "out" / "frame_000059.png"))
    assert filled(image, bar_boxes(layout(CAMERA), 3)[0], video.ASSIGNED) > 0.4


def test_a_filter_that_waits_draws_every_frame_too(drive: Path) -> None:
    made = {"evidence": "line_geometry", "graph": "position_in_lane"}
    experiment = write_experiment(drive / "e.yaml", filter="fixed_lag", lag=4, **made)
    done(*words(drive, "--experiment", experiment))
    assert len(list((drive / "out").iterdir())) == 6
    experiment = write_experiment(drive / "e.yaml", filter="smoothed", **made)
    said = refused(*words(drive, "--experiment", experiment, out="out2"))
    assert "filter: smoothed needs the whole drive" in said


def test_a_recording_is_drawn_beside_its_pictures(drive: Path) -> None:
    offset = np.tile([np.nan, 0.0, OFFSETS[1], OFFSETS[0]], (4, 1))
    there = np.isfinite(offset)
    log = LineLog(
        np.arange(12, 16), np.arange(12, 16) / 10, offset, there, there & (offset < 0), 10.0 * there
    )
    write_table(drive / "lines.csv", log)
    given = ["--n-lanes", 3, "-o", drive / "out", "--lines", drive / "lines.csv"]
    line = ["video", drive / "pictures", "--camera", drive / "cam.yaml", *given]
    done(*line)
    assert len(list((drive / "out").iterdir())) == 6
    u, v = road_to_image(CAMERA, 7.0, OFFSETS[0])
    for frame, has_lines in ((10, False), (12, True)):
        image = cv2.imread(str(drive / "out" / f"frame_{frame:06d}.png"))
        near = around(image, float(u), float(v))
        assert any(is_colour(p, video.CONTINUOUS, 40) for p in near) == has_lines
    assert "--detector: does not go with lines" in refused(*line, "--detector", "ml")
    write_table(drive / "lines.csv", replace(log, frame_id=np.arange(100, 104)))
    said = refused(*line)
    assert said.endswith("its frames are 100 to 103, the pictures 10 to 15")


def test_frames_before_an_interruption_are_kept(drive: Path) -> None:
    write_detector(drive, "if picture.frame_id == 13: raise KeyboardInterrupt")
    result = command(*words(drive, out="out.mp4"))
    assert result.exit_code == 130
    assert result.stderr == (
        f"egolane: interrupted; 3 frames are in {drive / 'out.mp4'}; the same command begins anew\n"
    )
    assert len(frames_of(drive / "out.mp4")) == 3


def test_a_picture_of_another_size_ends_the_video_after_those_before_it(drive: Path) -> None:
    cv2.imwrite(str(drive / "pictures" / "img_0012.png"), road()[:-8])
    said = refused(*words(drive))
    assert "frame 12: the picture has 640x392 pixels, the camera was calibrated" in said
    assert said.endswith(f"; the 2 frames before are in {drive / 'out'}")
    assert len(list((drive / "out").iterdir())) == 2


def test_what_is_missing_or_wrong_is_said_in_one_line(drive: Path) -> None:
    write_detector(drive, "raise ValueError('broken')")
    assert "ValueError: broken" in refused(*words(drive, out="a.mp4"))
    assert not (drive / "a.mp4").exists()
    write_detector(drive)
    assert "--frames: 5 2 is an empty range" in refused(*words(drive, "--frames", 5, 2))
    assert "no frame from 90 to before 95" in refused(*words(drive, "--frames", 90, 95))
    (drive / "truth.txt").write_text("10;5;0\n")
    said = refused(*words(drive, "--ground-truth", drive / "truth.txt"))
    assert "frame 10: lane 5 is outside 1..3" in said
    line = ["video", drive / "pictures", "--camera", drive / "cam.yaml", "-o", drive / "o"]
    assert refused(*line) == "--n-lanes: say how many lanes the road has"
    said = refused(*line, "--n-lanes", 3, "--detector", "mml")
    assert "--detector: unknown name 'mml' (did you mean 'ml'?)" in said
    assert not (drive / "o" / "frame_000010.png").exists()


def test_the_pictures_that_are_drawn_are_not_written_over(labels: Path) -> None:
    folder = labels.parent / "pics"
    before = contents(folder)
    for pictures in (folder, f"{folder}/*.png", folder / "frame_000000.png"):
        target = folder / ".." / "pics"
        said = refused(
            "video",
            pictures,
            "--camera",
            labels.with_name("cam.yaml"),
            "--n-lanes",
            3,
            "-o",
            target,
        )
        assert said == f"--out: {target} has the pictures that are drawn; name another place"
    assert contents(folder) == before


def test_valid_lines_are_drawn_at_offset_0_and_without_a_reliability_index(tmp_path: Path) -> None:
    (tmp_path / "lines.csv").write_text(
        "frame_id,line,offset_m,is_valid,is_continuous\n"
        "0,1,-1.7,true,true\n0,2,0.0,true,false\n0,3,1.8,false,true\n"
        "1,1,0.0,false,false\n1,2,1.8,true,true\n"
    )
    source = open_source(write_pictures(tmp_path / "pics", [empty_road()] * 2))
    log = read_lines(tmp_path / "lines.csv")
    pictures = (Picture(k, empty_road()) for k in range(2))
    first, second = (lines for _, lines in with_recorded_lines(pictures, log, source))
    assert first.offset_m.tolist() == [-1.7, 0.0, 1.8]
    assert first.is_valid.tolist() == [True, True, False]
    assert np.isnan(first.lri).all()
    assert second.offset_m.tolist() == [1.8]
