"""Short drives on a flat road with lines, and files of their pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import yaml

from egolane_pgm.vision.camera.model import write_camera
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.simulated import CAMERA, Paint, draw_road

PAIR = replace(CAMERA, baseline_m=0.4)

#: Pictures in the folder of `write_place`.
N_FRAMES = 16

THREE = (Paint(-5.2), Paint(-1.7, 4.0, 12.0), Paint(1.8))


def road(lines: Sequence[Paint] = THREE, travelled_m: float = 0.0, **given: Any) -> Image:
    """One picture; given: as of `draw_road`."""
    return draw_road(lines, travelled_m, **given)


def drive(
    n_frames: int,
    lines: Sequence[Paint] = THREE,
    *,
    sideways_m: float = 0.0,
    stereo: bool = False,
    step_m: float = 2.7,
    first: int = 0,
) -> list[Picture]:
    """Pictures of a drive of step_m per frame; the car moves sideways_m to the right per frame."""
    pictures = []
    for k in range(n_frames):
        here = [replace(p, offset_m=p.offset_m - k * sideways_m) for p in lines]
        image = road(here, k * step_m, seed=k)
        right = None
        if stereo:
            assert PAIR.baseline_m is not None
            second = replace(PAIR, lateral_m=PAIR.lateral_m + PAIR.baseline_m)
            right = road(here, k * step_m, camera=second, seed=1000 + k)
        pictures.append(Picture(first + k, image, right))
    return pictures


def write_video(
    path: Path, images: Sequence[Image], rate: float = 12.5, four: str = "MJPG"
) -> Path:
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*four), rate, (width, height))
    for image in images:
        writer.write(image)
    writer.release()
    return path


def write_pictures(folder: Path, images: Sequence[Image], name: str = "{:d}.png") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for k, image in enumerate(images):
        assert cv2.imwrite(str(folder / name.format(k)), image)
    return folder


def images(n: int) -> list[Image]:
    """The pictures of a drive."""
    return [picture.image for picture in drive(n)]


def write_place(folder: Path, n_frames: int = N_FRAMES) -> Path:
    """drive.avi, cam.yaml and run.yaml in a folder."""
    write_video(folder / "drive.avi", images(n_frames))
    write_camera(folder / "cam.yaml", CAMERA)
    content = {
        "name": "seen",
        "recording": {"path": "drive.avi", "camera": "cam.yaml", "detector": "ml"},
        "n_lanes": 2,
    }
    (folder / "run.yaml").write_text(yaml.safe_dump(content))
    return folder
