"""A disk that is full and a folder that goes away while pictures, videos or lines are written: one
line says so, and what was written before is whole."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from egolane_pgm.camera import writing as picture_files
from egolane_pgm.camera.writing import NotKeptError, video_writer, write_picture
from egolane_pgm.recordings import read_lines
from egolane_pgm.simulation.rendering import files as rendering_files
from egolane_pgm.simulation.rendering import traffic as traffics
from egolane_pgm.simulation.rendering.render import make_scene
from egolane_pgm.types import InputError, IntArray
from tests.kits.drives import command, done, refused
from tests.kits.synthetic_road import images, write_place

Usage = namedtuple("Usage", "total used free")

N_FRAMES = 8

#: A detector that does something when it sees a frame.
DETECTOR = """
import shutil
from egolane_pgm.detectors import ml
STEREO, PARAMETERS = False, ml.PARAMETERS
def start(camera, parameters):
    step = ml.start(camera, parameters)
    def seen(picture):
        if picture.frame_id == 5:
            {}
        return step(picture)
    return seen
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.avi and cam.yaml."""
    return write_place(tmp_path_factory.mktemp("camera"), N_FRAMES)


def words(place: Path, kind: str, target: Path, *more: object) -> list[object]:
    lanes = ["--n-lanes", 2] if kind == "video" else []
    return [kind, place / "drive.avi", "--camera", place / "cam.yaml", "-o", target, *lanes, *more]


def left(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def n_readable(video: Path) -> int:
    read = cv2.VideoCapture(str(video))
    count = 0
    while read.grab():
        count += 1
    return count


def filling(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """A disk that says it is full after so many questions."""
    answers = iter([10**12] * room)
    monkeypatch.setattr(
        picture_files.shutil, "disk_usage", lambda _: Usage(10**12, 0, next(answers, 10**5))
    )


def full_after(monkeypatch: pytest.MonkeyPatch, n_files: int) -> None:
    """A disk that takes so many pictures and a part of the next one."""
    real: Callable[[Path, bytes], int] = Path.write_bytes
    n_written = 0

    def write(path: Path, content: bytes) -> int:
        nonlocal n_written
        n_written += path.suffix in (".png", ".jpg")
        if n_written > n_files:
            real(path, content[:10])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", write)


# --- videos --------------------------------------------------------------------------------------


def test_a_video_ends_well_before_the_disk_is_full(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out.mp4"
    filling(monkeypatch, 3)
    said = refused(*words(place, "video", target))
    assert f"{target}: the disk is full (0.1 MB left" in said
    assert said.endswith(f"the 3 frames before are in {target}")
    assert left(tmp_path) == ["out.mp4"]
    assert n_readable(target) == 3


def test_a_disk_that_does_not_say_its_size_is_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_files.shutil, "disk_usage", lambda _: Usage(0, 0, 0))
    with video_writer(tmp_path / "a.mp4", 10, (480, 270)) as write:
        for image in images(2):
            write(image)
    assert n_readable(tmp_path / "a.mp4") == 2


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of a process")
def test_a_video_that_cannot_be_ended_is_not_said_to_be_there(place: Path, tmp_path: Path) -> None:
    """As on a disk that another process fills, or with a quota: OpenCV says nothing, the system
    takes no more bytes and the index is missing."""
    (tmp_path / "out.mp4").write_bytes(b"an earlier one")
    program = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000));"
        "from egolane_pgm.cli.main import main; main()"
    )
    given = [str(word) for word in words(place, "video", tmp_path / "out.mp4")]
    ran = subprocess.run(
        [sys.executable, "-c", program, *given], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 2, ran.stderr
    lines = ran.stderr.splitlines()
    assert len(lines) == 1, lines
    assert "out.mp4: cannot be written (is the disk full, or a limit reached?)" in lines[0]
    assert "nothing of the" in lines[0]
    assert left(tmp_path) == ["out.mp4"]
    assert (tmp_path / "out.mp4").read_bytes() == b"an earlier one"


@pytest.mark.parametrize("out", ["gone/out.mp4", "gone/pictures"])
def test_a_folder_that_goes_away_while_drawing_is_said(
    place: Path, tmp_path: Path, out: str
) -> None:
    (tmp_path / "gone").mkdir()
    own = tmp_path / "own.py"
    own.write_text(DETECTOR.format(f"shutil.rmtree({str(tmp_path / 'gone')!r})"))
    said = refused(*words(place, "video", tmp_path / out, "--detector", own))
    assert "cannot be written" in said
    assert "frames before" not in said, "they went with the folder"
    assert left(tmp_path) == ["own.py"]


def test_a_video_with_fewer_frames_than_were_written_is_kept_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_files, "_count", lambda _: 2)

    def drawn() -> None:
        with video_writer(tmp_path / "a.mp4", 10, (480, 270)) as write:
            for image in images(3):
                write(image)

    with pytest.raises(NotKeptError, match=r"a\.mp4: has 2 of 3 frames"):
        drawn()
    assert left(tmp_path) == ["a.mp4"]


# --- pictures and lines --------------------------------------------------------------------------


def test_no_half_picture_is_left_on_a_full_disk(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full_after(monkeypatch, 2)
    said = refused(*words(place, "video", tmp_path / "out"))
    assert "frame_000002.png: cannot be written: No space left on device" in said
    assert said.endswith(f"the 2 frames before are in {tmp_path / 'out'}")
    assert left(tmp_path) == ["out/frame_000000.png", "out/frame_000001.png"]
    before = (tmp_path / "out/frame_000000.png").read_bytes()
    with pytest.raises(InputError):
        write_picture(tmp_path / "out/frame_000000.png", images(1)[0])
    assert (tmp_path / "out/frame_000000.png").read_bytes() == before


def test_lines_of_a_folder_that_went_away_are_put_elsewhere(place: Path, tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    own = tmp_path / "own.py"
    own.write_text(DETECTOR.format(f"shutil.rmtree({str(tmp_path / 'gone')!r})"))
    target = tmp_path / "gone" / "lines.csv"
    said = refused(*words(place, "detect", target, "--detector", own))
    assert said.startswith(f"{target}: cannot be written: No such file or directory; the lines are")
    other = Path(said.split(" are in ")[1].removesuffix(" instead"))
    try:
        assert len(read_lines(other)) == N_FRAMES
    finally:
        shutil.rmtree(other.parent)


# --- rendered drives -----------------------------------------------------------------------------


def rendered(*more: object) -> list[object]:
    return ["simulate", "quickstart", "--images", *more]


def test_frames_rendered_before_the_disk_was_full_are_whole_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full_after(monkeypatch, 3)
    said = refused(*rendered("--stereo", "--frames", 4, "--out", tmp_path))
    assert "right/000001.jpg: cannot be written: No space left on device" in said
    assert said.endswith(f"1 of 4 frames are in {tmp_path}")
    assert left(tmp_path / "left") == left(tmp_path / "right") == ["000000.jpg"]
    rows = (tmp_path / "visibility.csv").read_text().splitlines()[1:]
    assert {row.split(",")[0] for row in rows} == {"0"}


def test_what_a_drive_costs_is_said_before_it_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rendering_files, "_ESTIMATED_FROM", 5)
    told = command(*rendered("--frames", 6, "--png", "--out", tmp_path / "a"))
    assert told.exit_code == 0
    said = told.stderr.splitlines()[0]
    size = sum(file.stat().st_size for file in (tmp_path / "a/images").iterdir())
    assert said.startswith("6 frames need about ")
    assert float(said.split()[4]) == pytest.approx(size / 1e6, rel=0.3)
    assert said.endswith(" seconds; Ctrl-C keeps those rendered")


def test_a_drive_that_the_disk_has_no_room_for_is_refused_before_it_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rendering_files, "_ESTIMATED_FROM", 5)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, 10**9))
    monkeypatch.setattr(rendering_files, "make_scene", lambda *a, **k: make_scene(a[0], a[1], 5))
    said = refused(*rendered("--frames", 9_000_000, "--out", tmp_path / "new" / "a"))
    assert "9000000 frames need about" in said
    assert "GB, the disk has 1.0 GB left; ask for fewer (--frames)" in said
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("video", [False, True])
def test_the_cost_of_a_frame_is_about_that_of_those_rendered(tmp_path: Path, video: bool) -> None:
    from egolane_pgm.simulation.rendering.files import cost_per_frame

    scene = make_scene("quickstart", 0, 26)
    seconds, size = cost_per_frame(scene, png=False, video=video)
    assert 0.001 < seconds < 10
    done(*rendered("--frames", 26, *(["--video"] if video else []), "--out", tmp_path))
    place = tmp_path / ("images.mp4" if video else "images")
    files = [place] if video else list(place.iterdir())
    assert size == pytest.approx(sum(f.stat().st_size for f in files) / 26, rel=0.25)


def test_vehicles_keep_clear_of_each_other_as_a_search_over_all_frames_finds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = traffics._possible
    n_kept = []

    def both(traffic: Any, time_s: Any, position_m: Any) -> IntArray:
        found = real(traffic, time_s, position_m)
        assert found.tolist() == plainly_possible(traffic, time_s, position_m)
        n_kept.append(len(found))
        return found

    monkeypatch.setattr(traffics, "_possible", both)
    for seed in range(3):
        make_scene("a4", seed, 1500)
    make_scene("a4", 0, 1)
    assert min(n_kept[:3]) > 5


def plainly_possible(traffic: Any, time_s: Any, position_m: Any) -> list[int]:
    kept: list[tuple[int, Any]] = []
    for k in range(len(traffic)):
        rear = np.interp(time_s[::3], traffic.time_s[k], traffic.x_m[k], left=np.nan, right=np.nan)
        front = rear + traffic.length_m[k]
        is_beside = np.abs(traffic.d_m[k] - position_m[::3]) < 2.9
        is_clear = not (is_beside & (front > -6) & (rear < 8)).any()
        for j, other in kept:
            if abs(traffic.d_m[j] - traffic.d_m[k]) < 2:
                far = other + traffic.length_m[j] + 4
                is_clear &= not ((rear < far) & (front > other - 4)).any()
        if is_clear:
            kept.append((k, rear))
    return [k for k, _ in kept]
