"""What a hurried user does to the commands about pictures and their lines: nothing that is read is
written over, every refusal is one line, and nothing is computed before what can be refused."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from egolane_pgm.camera.model import read_camera, road_to_image, write_camera
from egolane_pgm.camera.pictures import open_source, read_image, read_picture
from egolane_pgm.cli.video import _recorded
from egolane_pgm.experiment import load_experiment
from egolane_pgm.recordings.table import write_table
from egolane_pgm.report.tables import box_text
from egolane_pgm.report.video import frame_writer
from egolane_pgm.types import InputError
from tests.kits.drives import contents, done, refused, short_drive, write_drive
from tests.kits.synthetic_road import CAMERA, road, write_pictures

OFFSETS = (-5.2, -1.7, 1.8)
ROWS = list(range(150, CAMERA.height, 5))


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    """Labels of three pictures, which are beside them, and the camera."""
    entries = []
    (tmp_path / "pics").mkdir()
    far = np.geomspace(2, 300, 3000)[::-1]
    for k in range(3):
        name = f"pics/frame_{k:06d}.png"
        cv2.imwrite(str(tmp_path / name), road())
        lanes = []
        for offset in OFFSETS:
            u, v = road_to_image(CAMERA, far, offset)
            columns = np.interp(ROWS, v, u)
            lanes.append([u if 0 <= u < CAMERA.width else -2 for u in columns.round(2).tolist()])
        entries.append({"raw_file": name, "lanes": lanes, "h_samples": ROWS})
    path = tmp_path / "labels.jsonl"
    path.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    write_camera(tmp_path / "cam.yaml", CAMERA)
    return path


def huge_picture(path: Path) -> Path:
    """A file that says it is a picture of more pixels than OpenCV takes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    size = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 2, 0, 0, 0)
    data = chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    return path


# --- options of a format -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("frame_rate=abc", "frame_rate: 'abc' is not a number"),
        ("frame_rate=true", "frame_rate: True is not a number"),
        ("frame_rate=.nan", "frame_rate nan must be greater than 0"),
        ("frame_rate=.inf", "frame_rate inf must be greater than 0"),
        ("camera=5", "camera: 5 is not the name of a camera's YAML file"),
        ("camera={fx: 3}", "camera: {'fx': 3} is not the name of a camera's YAML file"),
        ("format=culane", "format tusimple has no option 'format'"),
        ("path=x", "format tusimple has no option 'path'"),
    ],
)
def test_an_option_of_another_kind_is_refused(labels: Path, setting: str, said: str) -> None:
    assert said in refused("convert", labels, labels.with_name("a.csv"), "--set", setting)
    assert not labels.with_name("a.csv").exists()


def test_an_experiments_options_cannot_stand_for_its_other_keys(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, 30, recording__options={"format": "table"})
    assert "format table has no option 'format'" in refused("run", experiment)


def test_the_topic_of_a_bag_is_a_name(tmp_path: Path) -> None:
    write_table(tmp_path / "a.csv", short_drive(30).log)
    done("convert", tmp_path / "a.csv", tmp_path / "a.bag")
    said = refused("convert", tmp_path / "a.bag", tmp_path / "b.csv", "--set", "topic=5")
    assert said == f"{tmp_path / 'a.bag'}: topic: 5 is not the name of a topic"


@pytest.mark.parametrize("key", ["preset", "seed", "frames", "n_lanes"])
def test_what_has_an_option_of_its_own_is_not_set(tmp_path: Path, key: str) -> None:
    said = refused("simulate", "--out", tmp_path / "drive", "--set", f"{key}=3")
    assert said == f"--set {key}: is given by an argument or option of its own"
    assert not (tmp_path / "drive").exists()


def test_a_line_far_beside_the_picture_is_refused(labels: Path) -> None:
    first = json.loads(labels.read_text().splitlines()[0])
    first["lanes"][1] = [1e18] * len(ROWS)
    labels.write_text(json.dumps(first) + "\n")
    said = refused(
        "convert", labels, labels.with_name("a.csv"), "--camera", labels.with_name("cam.yaml")
    )
    assert said.startswith(f"{labels}: line 1: a line reaches column 1e+18, the camera's pictures")


# --- lines ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", [-(10**30), 10**30])
def test_a_frame_that_no_array_can_hold_is_not_there(frame: int) -> None:
    log = short_drive(30).log
    nearest = int(log.frame_id[0 if frame < 0 else -1])
    with pytest.raises(InputError, match=f"has no frame {frame}; the nearest is {nearest} "):
        box_text(log, frame)


def test_the_nearest_frame_is_named_in_a_gap() -> None:
    log = short_drive(30).log.take(np.array([0, 1, 9, 10]))
    with pytest.raises(InputError, match=f"the nearest is {int(log.frame_id[2])} "):
        box_text(log, int(log.frame_id[2]) - 1)
    assert box_text(log, int(log.frame_id[2])).startswith("Line1: ")


def test_a_camera_that_nothing_would_look_through_is_refused(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, 30)
    table = tmp_path / "lines.csv"
    said = refused("lines", table, "--frame", 0, "--camera", "cam.yaml")
    assert said == f"--camera: the lines of {table} are in metres, they need no camera"
    said = refused("lines", experiment, "--frame", 0, "--camera", "cam.yaml")
    assert said == "--camera: an experiment names its own; --set recording.camera=FILE"


# --- video ---------------------------------------------------------------------------------------


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
        assert said == f"{target}: has the pictures that are drawn; name another place (-o)"
    assert contents(folder) == before


def test_a_video_is_not_written_over_itself(labels: Path) -> None:
    own = labels.with_name("drive.mp4")
    with frame_writer(own, 10, (CAMERA.width, CAMERA.height)) as write:
        for k in range(3):
            write(k, road())
    before = own.read_bytes()
    said = refused(
        "video", own, "--camera", labels.with_name("cam.yaml"), "--n-lanes", 3, "-o", own
    )
    assert said.endswith("has the pictures that are drawn; name another place (-o)")
    assert own.read_bytes() == before


def test_a_folder_in_the_place_of_a_video_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "d.mp4").mkdir()
    with (
        pytest.raises(InputError, match=r"d\.mp4: is a folder"),
        frame_writer(tmp_path / "d.mp4", 10, (64, 48)),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["d.mp4"]


def test_a_video_that_cannot_be_put_in_its_place_is_kept_beside_it(tmp_path: Path) -> None:
    target = tmp_path / "d.mp4"

    def draw() -> None:
        with frame_writer(target, 10, (64, 48)) as write:
            write(0, np.zeros((48, 64, 3), dtype=np.uint8))
            target.mkdir()

    with pytest.raises(InputError, match=r"cannot be written: .*; the video is in ") as caught:
        draw()
    kept = Path(str(caught.value).rpartition("the video is in ")[2])
    assert cv2.VideoCapture(str(kept)).read()[0]


@pytest.mark.parametrize("lines", [True, False])
def test_a_drive_without_one_picture_that_can_be_drawn_leaves_no_folder(
    labels: Path, lines: bool
) -> None:
    words: tuple[object, ...] = (labels.parent / "pics", "--camera", labels.with_name("cam.yaml"))
    words += ("--n-lanes", 3, "--frames", 900, 950, "-o", labels.parent / "new" / "out")
    said = refused("video", *words, *(("--lines", labels) if lines else ()))
    assert "no frame from 900 to before 950" in said
    assert not labels.with_name("new").exists()


def test_a_file_in_the_place_of_a_folder_of_drawn_pictures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    with (
        pytest.raises(InputError, match=r"out: a video ends in \.mp4; for PNG pictures name a"),
        frame_writer(tmp_path / "out", 10, (64, 48)),
    ):
        pass


def test_valid_lines_are_drawn_at_offset_0_and_without_a_reliability_index(tmp_path: Path) -> None:
    (tmp_path / "lines.csv").write_text(
        "frame_id,line,offset_m,is_valid,is_continuous\n"
        "0,1,-1.7,true,true\n0,2,0.0,true,false\n0,3,1.8,false,true\n"
        "1,1,0.0,false,false\n1,2,1.8,true,true\n"
    )
    source = open_source(write_pictures(tmp_path / "pics", [road()] * 2))
    lines = _recorded(
        str(tmp_path / "lines.csv"),
        CAMERA,
        source,
        load_experiment(write_drive(tmp_path / "x", 30)),
    )
    assert lines(0).offset_m.tolist() == [-1.7, 0.0, 1.8]
    assert lines(0).is_valid.tolist() == [True, True, False]
    assert np.isnan(lines(0).lri).all()
    assert lines(1).offset_m.tolist() == [1.8]


def test_a_picture_that_is_too_large_is_one_line_for_video_and_detect(labels: Path) -> None:
    huge = huge_picture(labels.parent / "huge.png")
    with pytest.raises(InputError, match=r"huge\.png: cannot be read: .*PIXELS"):
        read_image(huge)
    camera = labels.with_name("cam.yaml")
    for words in (("video", huge, "--n-lanes", 3, "-o", "v.mp4"), ("detect", huge, "-o", "d.csv")):
        target = labels.with_name(str(words[-1]))
        said = refused(*words[:-1], target, "--camera", camera)
        assert f"{huge}: cannot be read: " in said
        assert not target.exists()


def test_a_road_of_more_lanes_than_there_are_is_refused_at_once(labels: Path) -> None:
    said = refused(
        "video", labels.parent / "pics", "--camera", labels.with_name("cam.yaml"),
        "--n-lanes", 300, "-o", labels.with_name("out"),
    )  # fmt: skip
    assert said.endswith("n_lanes: input should be less than or equal to 50 (got 300)")
    words = (write_drive(labels.parent / "x", 30), "--set", "n_lanes=1000000000")
    for name in ("run", "validate", "learn", "compare", "tune"):
        assert "n_lanes: input should be less than or equal to 50" in refused(name, *words)
    said = refused("network", "lane_only", labels.with_name("n.png"), "--n-lanes", 51)
    assert said == "--n-lanes: 51 is more than 50"


# --- calibrate -----------------------------------------------------------------------------------


def calibrate(labels: Path, *words: object) -> tuple[object, ...]:
    return ("calibrate", "--lane-width", 3.5, "--lines", labels, *words)


def test_what_calibrate_reads_is_not_written_over(labels: Path) -> None:
    before = contents(labels.parent)
    assert refused(*calibrate(labels, "-o", labels)) == f"{labels}: is read here; name another file"
    still = labels.parent / "pics" / "frame_000001.png"
    said = refused(
        "calibrate", "--lane-width", 3.5, "--stills", still.parent, "--picture", still,
        "-o", labels.with_name("new.yaml"),
    )  # fmt: skip
    assert said == f"{still}: is read here; name another file"
    assert contents(labels.parent) == before


def test_a_size_that_the_pictures_do_not_have_is_refused(labels: Path) -> None:
    target = labels.with_name("new.yaml")
    picture = labels.parent / "pics" / "frame_000000.png"
    said = refused(*calibrate(labels, "-o", target, "--size", "960x540"))
    assert said == f"--size: {picture} is 480x270, not 960x540"
    for file in picture.parent.iterdir():
        file.unlink()
    said = refused(*calibrate(labels, "-o", target, "--size", "480x200"))
    assert (
        said == f"--size: the lines of {labels} reach down to row 265, below a picture of 480x200"
    )
    assert not target.exists()
    done(*calibrate(labels, "-o", target, "--size", "480x270"))
    assert read_camera(target).height_m == pytest.approx(CAMERA.height_m, rel=0.05)


def test_calibrate_makes_the_folders_that_its_files_need(labels: Path) -> None:
    camera, picture = labels.parent / "a" / "b" / "cam.yaml", labels.parent / "c" / "grid.png"
    done(*calibrate(labels, "-o", camera, "--picture", picture))
    assert read_camera(camera).width == CAMERA.width
    assert read_picture(picture).shape == (CAMERA.height, CAMERA.width, 3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--picture", "grid.txt"), "grid.txt: a picture's name ends in .png or .jpg or .jpeg"),
        (("--ignore", "0,300,480,400"), "--ignore: 0,300,480,400 is not in a picture of 480x270"),
        (("--ignore", "480,0,500,90"), "--ignore: 480,0,500,90 is not in a picture of 480x270"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    labels: Path, words: tuple[str, ...], said: str
) -> None:
    target = labels.with_name("new.yaml")
    assert refused(*calibrate(labels, "-o", target, *words)) == said
    assert not target.exists()


@pytest.mark.parametrize("board", ["2x6", "9x99999999999", "101x5"])
def test_a_board_that_there_is_not_is_refused(labels: Path, board: str) -> None:
    pictures = labels.parent / "pics"
    said = refused(
        "calibrate", "--lane-width", 3.5, "--stills", pictures, "--chessboards", pictures,
        "--board", board, "-o", labels.with_name("new.yaml"),
    )  # fmt: skip
    assert said == f"board {board}: needs 3x3 to 100x100 inner corners"


def test_a_picture_that_is_too_large_is_left_out(tmp_path: Path) -> None:
    huge = huge_picture(tmp_path / "huge.png")
    with pytest.raises(InputError, match=r"huge\.png: cannot be read: .*PIXELS") as caught:
        read_picture(huge)
    assert "\n" not in str(caught.value)
    said = refused("calibrate", "--lane-width", 3.5, "--stills", huge, "-o", tmp_path / "c.yaml")
    assert "no picture among 1 files" in said
