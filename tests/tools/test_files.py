"""How files are written and read, whatever is in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.simulation import simulate
from egolane_pgm.tools.files import (
    read_parquet,
    read_text,
    read_yaml,
    to_jsonable,
    write_json,
    write_yaml,
)
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, write_camera
from egolane_pgm.vision.camera.writing import write_picture
from tests.kits.rosbag_writer import write_lines

DRIVE = simulate("quickstart", frames=60)
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, height_m=1.3)
PICTURE = np.full((48, 64, 3), 7, dtype=np.uint8)

#: What writes each kind of file.
WRITERS: dict[str, Callable[[Path], object]] = {
    "lines.csv": lambda path: write_lines(path, DRIVE.log),
    "lines.parquet": lambda path: write_lines(path, DRIVE.log),
    "truth.txt": lambda path: write_ground_truth(path, DRIVE.truth),
    "scores.json": lambda path: write_json(path, {"a": 1}),
    "x.yaml": lambda path: write_yaml(path, {"a": 1}),
    "camera.yaml": lambda path: write_camera(path, CAMERA),
    "picture.png": lambda path: write_picture(path, PICTURE),
}


# --- one way to write a file -------------------------------------------------------------------


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_that_fails_keeps_the_older_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / name).write_text("before")

    def fails(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(InputError, match=f"{name}: cannot be written: No space left on device"):
        WRITERS[name](tmp_path / name)
    assert (tmp_path / name).read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == [name]


# --- one way to read text and YAML -------------------------------------------------------------


def test_a_text_is_read_without_the_mark_before_it(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_text(tmp_path / "a.yaml") == "a: 1\n"
    assert read_yaml(tmp_path / "a.yaml", "a: 1") == {"a": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"- 1", "needs keys and values, e.g. 'n_lanes: 4'"),
        (b"\xff\xfe\x00", "cannot be read: is not text in UTF-8"),
    ],
)
def test_a_file_that_is_not_yaml_is_refused_in_one_line(
    tmp_path: Path, content: bytes, message: str
) -> None:
    (tmp_path / "x.yaml").write_bytes(content)
    with pytest.raises(InputError, match=r"x\.yaml: ") as caught:
        read_yaml(tmp_path / "x.yaml", "n_lanes: 4")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "n_lanes: 3\na: 1\nn_lanes: 4\n",
            "is not YAML: line 3: key 'n_lanes' was given in line 1",
        ),
        (
            "a: 1\n\tb: 2\n",
            "is not YAML: line 2: found character '\\t' that cannot start any token",
        ),
        ('a: 1\nb: "a\\0b"', "is not YAML: line 2: a text contains a NUL character"),
        ("a: " + "[" * 3000, "is not YAML: is nested too deeply"),
        ("a: !!int ''", "is not YAML: string index out of range"),
    ],
)
def test_an_error_in_a_yaml_is_named_with_its_line(
    tmp_path: Path, content: str, message: str
) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_yaml(path, "n_lanes: 4")
    assert str(caught.value) == f"{path}: {message}"


@pytest.mark.parametrize("name", ["absent", "x" * 300, "a\0b"])
def test_a_path_that_cannot_be_opened_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"cannot be read: (No such file|File name|embedded null)"):
        read_text(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_parquet(tmp_path / name)


def test_stored_values_are_plain() -> None:
    stored = to_jsonable({1: np.float32(0.5), "a": np.array([[1.0, np.nan], [np.inf, 2.0]])})
    assert stored == {"1": 0.5, "a": [[1.0, None], [None, 2.0]]}
    assert type(to_jsonable((np.int64(3),))[0]) is int
