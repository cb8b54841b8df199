"""Pictures that are not what they should be: read rightly, or refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import pytest

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_image, read_pictures
from tests.kits.synthetic_road import CAMERA, images, write_pictures


def colourful() -> Image:
    """Smooth, so that JPEG changes little, and another one when it is turned."""
    v, u = np.mgrid[0:72, 0:128]
    return np.stack([2 * u, 3 * v, 255 - u - v], axis=2).astype(np.uint8)


def rgb(image: Image) -> PIL.Image.Image:
    return PIL.Image.fromarray(np.ascontiguousarray(image[:, :, ::-1]))


def write(path: Path, image: Any, *options: int) -> Path:
    assert cv2.imwrite(str(path), image, list(options))
    return path


def turned(path: Path, orientation: int) -> Path:
    """A picture whose camera says that it was held otherwise (EXIF tag 274)."""
    exif = PIL.Image.Exif()
    exif[274] = orientation
    rgb(colourful()).save(path, exif=exif, quality=98)
    return path


def test_grey_transparent_palette_and_cmyk_pictures_have_three_colours(tmp_path: Path) -> None:
    image = colourful()
    grey = read_image(write(tmp_path / "grey.png", image[:, :, 1]))
    np.testing.assert_array_equal(grey, image[:, :, 1:2].repeat(3, axis=2))
    through = np.dstack([image, image[:, :, 0]])
    np.testing.assert_array_equal(read_image(write(tmp_path / "alpha.png", through)), image)
    rgb(image).convert("CMYK").save(tmp_path / "cmyk.jpg", quality=98)
    rgb(image).quantize(256).save(tmp_path / "palette.png")
    for name in ("cmyk.jpg", "palette.png"):
        off = read_image(tmp_path / name).astype(float) - image
        assert np.abs(off).mean() < 8, name


def test_a_picture_is_turned_upright_as_its_camera_says(tmp_path: Path) -> None:
    upside_down = read_image(turned(tmp_path / "a.jpg", 3)).astype(float)
    assert np.abs(upside_down - colourful()[::-1, ::-1]).mean() < 3
    portrait = read_image(turned(tmp_path / "b.jpg", 6)).astype(float)
    assert np.abs(portrait - np.rot90(colourful(), -1)).mean() < 3


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.97])
@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_a_file_that_was_cut_off_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], ending: str, share: float
) -> None:
    whole = write(tmp_path / f"whole{ending}", images(1)[0]).read_bytes()
    cut = tmp_path / f"cut{ending}"
    cut.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError) as caught:
        read_image(cut)
    why = "is no picture that can be read (another kind of file, or cut off)"
    assert str(caught.value) == f"{cut}: {why if share else 'the file is empty'}"
    # OpenCV's own words, in another form, would stand beside the one line (libpng's stay).
    assert "WARN" not in capfd.readouterr().err


def read_all(folder: Path) -> int:
    return len(list(read_pictures(open_source(folder), CAMERA)))


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
        f"{folder / '2.png'}: frame 2: the picture has {size} pixels, the camera was calibrated for"
        " 480x270"
    )


def test_a_second_picture_of_another_size_is_refused(tmp_path: Path) -> None:
    left = write_pictures(tmp_path / "left", images(3))
    right = write_pictures(tmp_path / "right", images(3))
    write(right / "1.png", np.zeros((100, 200, 3), np.uint8))
    with pytest.raises(InputError, match=r"right/1\.png: frame 1: the picture has 200x100"):
        list(read_pictures(open_source(left), CAMERA, open_source(right)))
