"""Pictures of a simulated road with labels of its lines."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.vision.camera.model import road_to_image, write_camera
from tests.kits.synthetic_road import CAMERA, road

OFFSETS = (-5.2, -1.7, 1.8)
ROWS = list(range(150, CAMERA.height, 5))


def write_labelled(folder: Path) -> Path:
    """Labels of three pictures, which are beside them, and the camera."""
    entries = []
    (folder / "pics").mkdir()
    far = np.geomspace(2, 300, 3000)[::-1]
    for k in range(3):
        name = f"pics/frame_{k:06d}.png"
        cv2.imwrite(str(folder / name), road())
        lanes = []
        for offset in OFFSETS:
            u, v = road_to_image(CAMERA, far, offset)
            columns = np.interp(ROWS, v, u)
            lanes.append([u if 0 <= u < CAMERA.width else -2 for u in columns.round(2).tolist()])
        entries.append({"raw_file": name, "lanes": lanes, "h_samples": ROWS})
    path = folder / "labels.jsonl"
    path.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    write_camera(folder / "cam.yaml", CAMERA)
    return path
