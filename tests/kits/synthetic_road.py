"""Pictures of a flat road with lines, drawn ray by ray without any code of the detectors or the
simulation, and files of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from egolane_pgm.vision.camera.model import Camera, image_to_road, write_camera
from egolane_pgm.vision.camera.picture import Image, Picture

CAMERA = Camera(480, 270, 390.0, 390.0, 239.5, 134.5, height_m=1.4, pitch_deg=-4.0)
PAIR = replace(CAMERA, baseline_m=0.4)

#: Pictures in the folder of `write_place`.
N_FRAMES = 16


@dataclass(frozen=True)
class Paint:
    """A line y(x) = offset + heading x + curvature x^2 / 2 + rate x^3 / 6, dashed where period >
    dash."""

    offset_m: float
    dash_m: float = 1.0
    period_m: float = 1.0
    heading: float = 0.0
    curvature: float = 0.0
    width_m: float = 0.15
    grey: float = 225.0
    rate: float = 0.0


THREE = (Paint(-5.2), Paint(-1.7, 4.0, 12.0), Paint(1.8))


def road(
    lines: Sequence[Paint] = THREE,
    travelled_m: float = 0.0,
    *,
    camera: Camera = CAMERA,
    seed: int = 0,
    noise: float = 3.0,
) -> Image:
    """One picture: grey asphalt with noise, painted lines, a lighter sky."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = image_to_road(camera, u, v)
    rng = np.random.default_rng(seed)
    grey = np.where(np.isnan(x), 180.0, 95.0)
    for line in lines:
        middle = line.offset_m + x * (line.heading + x * (line.curvature / 2 + x * line.rate / 6))
        with np.errstate(invalid="ignore"):
            is_paint = np.abs(y - middle) < line.width_m / 2
            is_paint &= np.mod(x + travelled_m, line.period_m) < line.dash_m
            # What is too far is too thin to be told from the road.
            is_paint &= x < 80
        grey = np.where(is_paint, line.grey, grey)
    grey = grey + rng.normal(0, noise, grey.shape)
    one: Image = np.clip(grey, 0, 255).astype(np.uint8)
    return np.repeat(one[:, :, None], 3, axis=2)


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
