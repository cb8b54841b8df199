"""Every detector on pictures that show no road: no traceback, and no valid line."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.plugins import plugin_names
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, with_vanishing_point
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors.runner import detect, find_detector
from tests.kits.synthetic_road import CAMERA, PAIR, drive, road
from tests.kits.tiny_network import top_hat_file

NAMES = plugin_names("detectors")
every_detector = pytest.mark.parametrize("name", NAMES)

#: As many pictures as a line needs to become valid, and two more.
N_PICTURES = 12


def flat(grey: int) -> Image:
    return np.full((CAMERA.height, CAMERA.width, 3), grey, dtype=np.uint8)


def with_bright(rows: slice) -> Image:
    image = flat(90)
    image[rows] = 255
    return image


CHECKERS = 255 * (np.indices((CAMERA.height, CAMERA.width)).sum(0) // 8 % 2)

#: Pictures that are not of a road.
PLAIN = {
    "black": flat(0),
    "white": flat(255),
    "one bright row": with_bright(slice(200, 201)),
    "bright below": with_bright(slice(150, None)),
    "a road upside down": road()[::-1].copy(),
    "checkers": CHECKERS.astype(np.uint8)[:, :, None].repeat(3, axis=2),
}


@functools.cache
def pictures_of(kind: str) -> list[Image]:
    """The pictures of a kind, each a little different."""
    rng = np.random.default_rng(0)
    if kind == "noise":
        size = (N_PICTURES, CAMERA.height, CAMERA.width, 3)
        return list(rng.integers(0, 256, size, dtype=np.uint8))
    image = PLAIN[kind].astype(int)
    grain = rng.integers(-2, 3, (N_PICTURES, *image.shape))
    grain[:2] = 0
    return list(np.clip(image + grain, 0, 255).astype(np.uint8))


def valid_lines(name: str, camera: Camera, pictures: Iterable[Picture]) -> list[int]:
    """How many valid lines there are in each picture."""
    given = {}
    if name == "network":
        given["network"] = str(top_hat_file(CAMERA.width, CAMERA.height))
    detector = find_detector(name, given, Path.cwd(), "detector")
    seen = replace(camera, baseline_m=PAIR.baseline_m if detector.is_stereo else None)
    return [int(found.is_valid.sum()) for _, found in detect(detector, seen, pictures)]


def pairs(images: Iterable[Image]) -> list[Picture]:
    """Both cameras see the same; a detector with one camera looks at the first."""
    return [Picture(k, image, image.copy()) for k, image in enumerate(images)]


@every_detector
@pytest.mark.parametrize("kind", [*PLAIN, "noise"])
def test_what_shows_no_road_is_looked_at_without_harm(name: str, kind: str) -> None:
    valid = valid_lines(name, CAMERA, pairs(pictures_of(kind)))
    assert len(valid) == N_PICTURES
    if kind in ("black", "white", "noise"):
        assert sum(valid) == 0


@pytest.fixture(scope="module")
def of_a_road() -> list[Picture]:
    return drive(14, stereo=True, first=6)


@every_detector
def test_a_road_is_seen_after_black_and_white_pictures(name: str, of_a_road: list[Picture]) -> None:
    blank = pairs([*pictures_of("black")[:3], *pictures_of("white")[:3]])
    valid = valid_lines(name, CAMERA, [*blank, *of_a_road])
    assert valid[:6] == [0] * 6
    assert valid[-1] > 0


@every_detector
def test_a_road_is_seen_though_every_fifth_picture_is_black(name: str) -> None:
    black = flat(0)
    pictures = [
        replace(picture, image=black, right=black) if picture.frame_id % 5 == 4 else picture
        for picture in drive(22, stereo=True)
    ]
    valid = valid_lines(name, CAMERA, pictures)
    assert min(valid[18:]) >= 2


@every_detector
@pytest.mark.parametrize(("width", "height"), [(270, 480), (481, 271), (16, 16)])
def test_portrait_odd_and_tiny_pictures_do_no_harm(name: str, width: int, height: int) -> None:
    """A detector may refuse a camera in one line; it must not fall over."""
    camera = replace(CAMERA, width=width, height=height, cx=width / 2, cy=height / 2)
    camera = with_vanishing_point(camera, width / 2, height * 0.4)
    images = [road(camera=camera, travelled_m=2.0 * k, seed=k) for k in range(3)]
    said: list[object] = []
    try:
        said.extend(valid_lines(name, camera, pairs(images)))
    except InputError as error:
        said.append(str(error))
    assert len(said) == (1 if isinstance(said[0], str) else 3)


@every_detector
@pytest.mark.parametrize("size", [(135, 240), (270, 481)])
def test_a_picture_of_another_size_ends_a_drive_in_one_line_that_names_the_frame(
    name: str, size: tuple[int, int]
) -> None:
    changed = np.zeros((*size, 3), dtype=np.uint8)
    with pytest.raises(InputError, match=r"frame 2: .*pixels") as caught:
        valid_lines(name, CAMERA, pairs([road(), road(seed=1), changed]))
    assert "\n" not in str(caught.value)
