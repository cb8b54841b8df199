"""A recording of labels, with its camera."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import lane_truth
from egolane_pgm.vision.camera.model import Camera, road_to_image, write_camera
from tests.kits.drives import write_experiment

CAMERA = Camera(width=480, height=270, fx=390, fy=390, cx=240, cy=135, height_m=1.4, pitch_deg=-4)
N_LABELLED = 12


def write_labelled_drive(folder: Path) -> Path:
    """An experiment on a file of TuSimple's labels, its camera beside it."""
    folder.mkdir(parents=True)
    x, rows = np.geomspace(60, 4, 400), list(range(130, 260, 5))
    lanes = []
    for offset in (-5.2, -1.7, 1.8, 5.3):
        u, v = road_to_image(CAMERA, x, np.full_like(x, offset))
        lanes.append(np.interp(rows, v, u, left=-2, right=-2).tolist())
    entries = [
        {"raw_file": f"{k:05d}.jpg", "lanes": lanes, "h_samples": rows} for k in range(N_LABELLED)
    ]
    (folder / "labels.json").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    write_camera(folder / "cam.yaml", CAMERA)
    lane, is_crossing = np.full(N_LABELLED, 2), np.zeros(N_LABELLED, dtype=bool)
    write_ground_truth(folder / "t.txt", lane_truth(np.arange(N_LABELLED), lane, is_crossing))
    return write_experiment(
        folder / "x.yaml",
        recording={"path": "labels.json", "camera": "cam.yaml"},
        ground_truth={"path": "t.txt"},
        graph="lane_only",
    )
