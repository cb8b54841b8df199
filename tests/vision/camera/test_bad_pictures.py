"""Pictures that are not what they should be: read rightly, or refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_image, read_pictures
from tests.kits.synthetic_road import CAMERA, images, write_pictures


def write(path: Path, image: Any, *options: int) -> Path:
    assert cv2.imwrite(str(path), image, list(options))
    return path


def test_a_file_that_is_no_picture_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = write(tmp_path / "whole.jpg", images(1)[0]).read_bytes()
    png = write(tmp_path / "whole.png", images(1)[0]).read_bytes()
    for content in (b"", whole[:99], whole[: len(whole) // 2], whole[:-2], png[: len(png) // 2]):
        (tmp_path / "cut.jpg").write_bytes(content)
        with pytest.raises(
            InputError, match=r"cut\.jpg: is not a picture that can be read \(missing"
        ):
            read_image(tmp_path / "cut.jpg")
    (tmp_path / "cut.jpg").write_bytes(whole + bytes(9))
    assert read_image(tmp_path / "cut.jpg").shape == images(1)[0].shape
    # OpenCV's own words, in another form, would stand beside the one line.
    assert "WARN" not in capfd.readouterr().err


def read_all(folder: Path) -> int:
    return len(list(read_pictures(open_source(folder), CAMERA)))


@pytest.mark.parametrize(
    ("left", "right", "ids"),
    [([2], None, [0, 1, 3]), ([0], None, [1, 2, 3]), ([1], [3], [0, 2]), ([0, 1], [1], [2, 3])],
)
def test_frames_with_a_damaged_picture_are_left_out_with_a_warning(
    tmp_path: Path, left: list[int], right: list[int] | None, ids: list[int]
) -> None:
    shades = [np.full((CAMERA.height, CAMERA.width, 3), 50 * k, np.uint8) for k in range(4)]
    places = [write_pictures(tmp_path / name, shades) for name in ("left", "right")]
    for folder, damaged in zip(places, (left, right or []), strict=True):
        for k in damaged:
            (folder / f"{k}.png").write_bytes(b"no picture")
    one, other = map(open_source, places)
    first = f"left out {4 - len(ids)} of 4 frames whose picture cannot be read, first {places[0]}"
    with pytest.warns(UserWarning, match=f"^{places[0]}: {first}/{left[0]}.png: is not a picture"):
        found = list(read_pictures(one, CAMERA, None if right is None else other))
    assert [picture.frame_id for picture in found] == ids
    assert [int(picture.image.mean()) // 50 for picture in found] == ids
    if right is not None:
        assert [int(picture.right.mean()) // 50 for picture in found] == ids


def test_pictures_that_are_all_damaged_are_refused_with_the_first(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "p", images(2))
    for k in range(2):
        (folder / f"{k}.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"p/0\.png: is not a picture that can be read"):
        read_all(folder)


@pytest.mark.parametrize(
    ("odd", "size"),
    [
        (np.zeros((CAMERA.width, CAMERA.height, 3), np.uint8), "270x480"),
        (np.zeros((540, 960, 3), np.uint8), "960x540"),
    ],
)
def test_among_pictures_of_one_size_another_is_named(tmp_path: Path, odd: Image, size: str) -> None:
    folder = write_pictures(tmp_path / "p", images(4))
    assert read_all(folder) == 4
    write(folder / "2.png", odd)
    with pytest.raises(InputError) as caught:
        read_all(folder)
    assert str(caught.value).startswith(
        f"{folder / '2.png'}: frame 2: a picture of {size} pixels, but the camera was calibrated"
        " for 480x270"
    )
