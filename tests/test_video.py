"""A drive drawn: lines, bird's-eye view, bars of the belief; as a video or as pictures; and the
paper's Box 1 as text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from drives import command, done, refused, write_experiment

from egolane_pgm import _cli_video
from egolane_pgm.camera import Camera, road_to_image, write_camera
from egolane_pgm.detectors import FrameLines, Picture
from egolane_pgm.experiment import load_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.report import video
from egolane_pgm.report.box import box_text
from egolane_pgm.report.video import Scene, bar_boxes, draw_frame, frame_writer, layout
from egolane_pgm.types import InputError, LaneTruth, LineLog

CAMERA = Camera(
    width=640, height=400, fx=500, fy=500, cx=320, cy=200, height_m=1.4, pitch_deg=-3, yaw_deg=0.5
)
OFFSETS = (-1.9, 1.6, 5.2)
LINES = FrameLines(
    np.array([[offset, 0.0, 0.0, 0.0] for offset in OFFSETS]),
    np.array([True, True, False]),
    np.array([True, False, True]),
    np.array([10.0, 10.0, 3.0]),
)

#: A detector that says the same of every picture.
DETECTOR = """
    import numpy as np
    from egolane_pgm.detectors import FrameLines
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


def road(camera: Camera = CAMERA) -> np.ndarray:
    """A grey picture."""
    return np.full((camera.height, camera.width, 3), 90, dtype=np.uint8)


def scene(belief: list[float], assigned: int, **more: object) -> Scene:
    values = np.array(belief)
    return replace(Scene(7, 0.7, LINES, values, assigned), **more)  # type: ignore[arg-type]


def drawn(one: Scene) -> np.ndarray:
    return draw_frame(layout(CAMERA), road(), one)


def is_colour(pixel: np.ndarray, colour: tuple[int, int, int], tolerance: int = 12) -> bool:
    return bool((np.abs(pixel.astype(int) - colour) <= tolerance).all())


def around(image: np.ndarray, u: float, v: float) -> np.ndarray:
    """The pixels near a place."""
    row, column = round(v), round(u)
    return image[row - 1 : row + 2, column - 2 : column + 3].reshape(-1, 3)


# --- one frame -----------------------------------------------------------------------------------


def test_a_frame_has_the_picture_the_birds_eye_view_and_a_panel() -> None:
    places = layout(CAMERA)
    image = drawn(scene([1, 0], 1))
    assert image.shape == (places.size[1], places.size[0], 3)
    assert places.size[0] % 2 == places.size[1] % 2 == 0
    assert places.picture == (640, 400)
    assert places.birdseye == (200, 400)
    assert image.shape[0] >= 400 + 150
    # The sky is as it was, the paper below is white.
    assert is_colour(image[5, 5], (90, 90, 90), 0)
    assert is_colour(image[-2, 2], (255, 255, 255), 0)


def test_a_lens_does_not_fold_the_road_back_into_the_picture() -> None:
    bent = replace(CAMERA, distortion=(-0.25, -0.02, 0.0, 0.0, 0.0))
    image = draw_frame(layout(bent), road(bent), scene([1, 0], 1))
    u, v = road_to_image(bent, 8.0, OFFSETS[0])
    assert any(is_colour(p, video.CONTINUOUS, 40) for p in around(image, float(u), float(v)))
    assert (image[:130, :640] == 90).all(), "there is nothing above the horizon"


def test_small_pictures_are_drawn_larger_and_odd_ones_are_made_even() -> None:
    small = replace(CAMERA, width=321, height=101, cx=160, cy=20)
    places = layout(small)
    assert places.picture[1] == 360
    assert places.size[0] % 2 == places.size[1] % 2 == 0
    image = draw_frame(places, road(small), scene([1, 0], 1))
    assert image.shape == (places.size[1], places.size[0], 3)


@pytest.mark.parametrize("ahead", [6.5, 7.5, 13.0])
def test_lines_are_drawn_where_they_are_in_the_colours_of_the_legend(ahead: float) -> None:
    image = drawn(scene([1, 0], 1))
    colours = (video.CONTINUOUS, video.DASHED, video.NOT_VALID)
    for offset, colour in zip(OFFSETS, colours, strict=True):
        u, v = road_to_image(CAMERA, ahead, offset)
        if u < 630 and v < 390:
            assert any(is_colour(p, colour, 40) for p in around(image, float(u), float(v)))


def test_only_a_continuous_line_has_no_gaps() -> None:
    image = drawn(scene([1, 0], 1))
    for offset, colour in ((OFFSETS[0], video.CONTINUOUS), (OFFSETS[1], video.DASHED)):
        for ahead, is_dash in ((7.5, True), (10.5, False), (13.5, True)):
            u, v = road_to_image(CAMERA, ahead, offset)
            is_drawn = any(is_colour(p, colour, 60) for p in around(image, float(u), float(v)))
            assert is_drawn == (is_dash or colour == video.CONTINUOUS)


def test_the_birds_eye_view_shows_lines_and_road_to_scale() -> None:
    places = layout(CAMERA)
    picture = road()
    # A white cross-stroke on the road, 20 m ahead, from 3 m left to 3 m right.
    u, v = road_to_image(CAMERA, 20.0, np.array([-3.0, 3.0]))
    ends = [(round(a), round(b)) for a, b in zip(u.tolist(), v.tolist(), strict=True)]
    cv2.line(picture, ends[0], ends[1], (255, 255, 255), 2)
    none = FrameLines(np.zeros((0, 4)), *(np.zeros(0, dtype=bool),) * 2, np.zeros(0))
    image = draw_frame(places, picture, scene([1, 0], 1, lines=none))
    view = image[:400, 640:840]
    row = round(400 * (40 - 20) / 40)
    bright = np.flatnonzero(view[row - 6 : row + 7].max(axis=(0, 2)) > 180)
    bright = bright[bright > 30]  # right of the scale
    metres = (bright[[0, -1]] + 0.5) * 20 / 200 - 10
    np.testing.assert_allclose(metres, [-3, 3], atol=0.5)
    view = drawn(scene([1, 0], 1))[:400, 640:840]
    column = round((OFFSETS[0] + 10) * 200 / 20)
    assert any(is_colour(p, video.CONTINUOUS, 40) for p in around(view, column, 250))


def test_lines_that_are_behind_or_far_beside_the_camera_do_no_harm() -> None:
    wild = FrameLines(
        np.array([[-500.0, -50.0, 3.0, 9.0], [0.0, 0.0, 0.0, 0.0], [1e9, 1e9, 0.0, 0.0]]),
        *(np.ones(3, dtype=bool),) * 2,
        np.ones(3),
    )
    drawn(scene([1, 0], 1, lines=wild))
    up = replace(CAMERA, pitch_deg=50)
    draw_frame(layout(up), road(up), scene([1, 0], 1))


# --- bars ----------------------------------------------------------------------------------------


def filled(
    image: np.ndarray, box: tuple[int, int, int, int], colour: tuple[int, int, int]
) -> float:
    """The share of a bar's height that has the colour, in its middle column."""
    left, upper, right, lower = box
    column = image[upper + 1 : lower, (left + right) // 2]
    return float(np.mean([is_colour(p, colour, 2) for p in column]))


def test_bars_show_the_belief_over_the_lanes_from_left_to_right() -> None:
    belief = [0.1, 0.6, 0.25, 0.05]
    image = drawn(scene(belief, 2))
    boxes = bar_boxes(layout(CAMERA), 4)
    lefts = [box[0] for box in boxes]
    assert lefts == sorted(lefts)
    assert all(a[2] < b[0] for a, b in pairwise(boxes))
    for k, share in enumerate(belief):
        colour = video.ASSIGNED if k == 1 else video.OTHER
        assert filled(image, boxes[k], colour) == pytest.approx(share, abs=0.04)
    # The last one is for no answer, and empty here.
    assert filled(image, boxes[4], (255, 255, 255)) == 1


def test_unassigned_is_shown_and_no_lane_is_marked() -> None:
    image = drawn(scene([0.5, 0.5], 0))
    boxes = bar_boxes(layout(CAMERA), 2)
    assert filled(image, boxes[2], video.INK) == 1
    for box in boxes[:2]:
        assert filled(image, box, video.OTHER) == pytest.approx(0.5, abs=0.05)
        assert filled(image, box, video.ASSIGNED) == 0


def test_the_true_lane_is_outlined_where_it_is_known() -> None:
    boxes = bar_boxes(layout(CAMERA), 3)
    for truth in (None, 1, 3):
        image = drawn(scene([0, 1, 0], 2, truth=truth))
        for k, (left, upper, _, lower) in enumerate(boxes[:3]):
            outline = image[(upper + lower) // 2, left - 3]
            assert is_colour(outline, video.TRUTH, 3) == (truth == k + 1)
    plain = drawn(scene([0, 1, 0], 2, truth=1))
    assert (plain != drawn(scene([0, 1, 0], 2, truth=1, is_crossing=True))).any()


def test_eight_lanes_fit() -> None:
    boxes = bar_boxes(layout(CAMERA), 8)
    assert len(boxes) == 9
    assert boxes[-1][2] <= 640
    drawn(scene([1 / 8] * 8, 0, truth=8))


# --- files ---------------------------------------------------------------------------------------


def frames_of(path: Path) -> list[np.ndarray]:
    read = cv2.VideoCapture(str(path))
    images = []
    while True:
        is_there, image = read.read()
        if not is_there:
            return images
        images.append(image)


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
    for target, said in (
        (tmp_path / "none" / "a.mp4", "a.mp4: cannot be written: no such folder"),
        (tmp_path / "a.avi", "a.avi: a video ends in .mp4; for PNG pictures name a folder"),
        (tmp_path / "file" / "b", "cannot be written"),
    ):
        with pytest.raises(InputError) as caught, frame_writer(target, 10, size):
            pass
        assert said in str(caught.value)


# --- the command ---------------------------------------------------------------------------------


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
    line = words(drive, "--truth", drive / "truth.txt", out="out.mp4")
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
    assert "--detector: does not go with --lines" in refused(*line, "--detector", "ml")
    write_table(drive / "lines.csv", replace(log, frame_id=np.arange(100, 104)))
    said = refused(*line)
    assert said.endswith("its frames are 100 to 103, the pictures 10 to 15")


def test_one_picture_at_a_time_is_in_memory(drive: Path) -> None:
    made = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    experiment = load_experiment(write_experiment(drive / "e.yaml", **made))
    n_read = 0

    def pairs() -> Iterator[tuple[Picture, FrameLines]]:
        nonlocal n_read
        for k in range(20):
            n_read += 1
            yield Picture(k, road()), LINES

    for k, (picture, one) in enumerate(_cli_video._scenes(pairs(), experiment, None, "x")):
        assert (picture.frame_id, one.frame_id, n_read) == (k, k, k + 1)
    assert n_read == 20


# --- refused, and interrupted --------------------------------------------------------------------


def test_frames_before_an_interruption_are_kept(drive: Path) -> None:
    write_detector(drive, "if picture.frame_id == 13: raise KeyboardInterrupt")
    result = command(*words(drive, out="out.mp4"))
    assert result.exit_code == 130
    assert result.stderr == f"egolane: interrupted; 3 frames are in {drive / 'out.mp4'}\n"
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
    assert "--frames 5 2: is an empty range" in refused(*words(drive, "--frames", 5, 2))
    assert "no frame from 90 to before 95" in refused(*words(drive, "--frames", 90, 95))
    (drive / "truth.txt").write_text("10;5;0\n")
    said = refused(*words(drive, "--truth", drive / "truth.txt"))
    assert "frame 10: lane 5 is outside 1..3" in said
    line = ["video", drive / "pictures", "--camera", drive / "cam.yaml", "-o", drive / "o"]
    assert refused(*line) == "--n-lanes: say how many lanes the road has"
    said = refused(*line, "--n-lanes", 3, "--detector", "mml")
    assert "--detector: unknown name 'mml' (did you mean 'ml'?)" in said
    assert not (drive / "o" / "frame_000010.png").exists()


# --- Box 1 ---------------------------------------------------------------------------------------

#: The paper's Box 1.
BOX = """\
Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m
Line2: isValid = 0; continuous=0; LRI: 09; offset: -6.47m
Line3: isValid = 1; continuous=0; LRI: 07; offset: -2.15m
Line4: isValid = 0; continuous=1; LRI: 00; offset: +0.99m"""


def box_log() -> LineLog:
    """Frame 1234 is the paper's; 1236 has no line, 1237 has two of which little is known."""
    nan = np.nan
    offset = np.array([[-9.15, -6.47, -2.15, 0.99, nan], [nan] * 5, [nan, 1.5, nan, nan, nan]])
    valid = np.array([[1, 0, 1, 0, 0], [0] * 5, [0, 1, 0, 0, 0]], dtype=bool)
    continuous = np.array([[1, 0, 0, 1, 0], [0] * 5, [0] * 5], dtype=bool)
    lri = np.array([[10, 9, 7, 0, nan], [nan] * 5, [3, nan, nan, nan, nan]])
    frame_id = np.array([1234, 1236, 1237])
    return LineLog(frame_id, frame_id / 10, offset, valid, continuous, lri, source="box.csv")


def test_the_papers_box_is_printed_as_in_the_paper() -> None:
    assert box_text(box_log(), 1234) == BOX
    assert box_text(box_log(), 1236) == "no lines"
    unknown = box_text(box_log(), 1237).splitlines()
    assert unknown == [
        "Line1: isValid = 0; continuous=0; LRI: 03; offset: --",
        "Line2: isValid = 1; continuous=0; LRI: --; offset: +1.50m",
    ]


def test_the_command_prints_it_from_a_recording_and_from_an_experiment(tmp_path: Path) -> None:
    write_table(tmp_path / "box.parquet", box_log())
    assert done("lines", tmp_path / "box.parquet", "--frame", 1234).stdout == BOX + "\n"
    recording = {"path": "box.parquet"}
    experiment = write_experiment(tmp_path / "e.yaml", recording=recording, ground_truth=None)
    assert done("lines", experiment, "--frame", 1234).stdout == BOX + "\n"
    said = refused("lines", tmp_path / "box.parquet", "--frame", 1235)
    assert said.endswith("has no frame 1235; the nearest is 1234 (frames 1234 to 1237)")
    said = refused("lines", tmp_path / "box.parquet", "--frame", 1234, "--set", "n_lanes=3")
    assert said == "--set: goes with an experiment"
    assert "no such file" in refused("lines", tmp_path / "none.csv", "--frame", 1)
