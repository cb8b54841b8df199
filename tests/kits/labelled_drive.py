"""A recording that is a folder of labels, with its camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import LaneTruth
from egolane_pgm.vision.camera.model import Camera, road_to_image, write_camera
from tests.kits.drives import write_experiment

CAMERA = Camera(width=480, height=270, fx=390, fy=390, cx=240, cy=135, height_m=1.4, pitch_deg=-4)
N_LABELLED = 12


def write_labelled_drive(folder: Path) -> Path:
    """An experiment on a folder of CULane's files, its camera beside it."""
    (folder / "labels").mkdir(parents=True)
    x = np.linspace(5, 40, 20)
    text = ""
    for offset in (-5.2, -1.7, 1.8, 5.3):
        u, v = road_to_image(CAMERA, x, np.full_like(x, offset))
        text += " ".join(f"{a:.2f} {b:.2f}" for a, b in zip(u, v, strict=True)) + "\n"
    for k in range(N_LABELLED):
        (folder / "labels" / f"{k:05d}.lines.txt").write_text(text)
    write_camera(folder / "cam.yaml", CAMERA)
    lane, is_crossing = np.full(N_LABELLED, 2), np.zeros(N_LABELLED, dtype=bool)
    write_ground_truth(folder / "t.txt", LaneTruth(np.arange(N_LABELLED), lane, is_crossing))
    return write_experiment(
        folder / "x.yaml",
        recording={"path": "labels", "camera": "cam.yaml", "options": {"valid": "always"}},
        ground_truth={"path": "t.txt"},
        graph="lane_only",
    )
