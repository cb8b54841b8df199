"""Pictures of a simulated road with labels of its lines."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import yaml

from egolane_pgm.vision.camera.model import road_to_image, write_camera
from tests.kits.synthetic_road import CAMERA, road

OFFSETS = (-5.2, -1.7, 1.8)
BOUNDS = {"detector.least_contrast": [0.005, 0.5], "detector.least_score": [0.02, 0.9]}
ROWS = list(range(150, CAMERA.height, 5))


def write_stills(folder: Path) -> Path:
    """A tuning file for six labelled stills whose marking is fainter from one to the next."""
    labels = write_labelled(folder)
    first = json.loads(labels.read_text().splitlines()[0])
    image = cv2.imread(str(folder / first["raw_file"])).astype(np.float64)
    with labels.open("w") as file:
        for k, share in enumerate((1.0, 0.2, 0.1, 0.07, 0.04, 0.02)):
            name = f"pics/frame_{k:06d}.png"
            grey = np.median(image) + share * (image - np.median(image))
            cv2.imwrite(str(folder / name), grey.astype(np.uint8))
            file.write(json.dumps({**first, "raw_file": name}) + "\n")
    return write_picture_plan(folder / "stills.yaml")


def write_picture_plan(path: Path) -> Path:
    """A tuning file for the labelled pictures beside it."""
    content = {
        "name": path.stem,
        "pictures": {"labels": "labels.jsonl", "camera": "cam.yaml", "detector": "ml"},
        "tuning": {"trials": 8, "blocks": 2, "parameters": BOUNDS},
    }
    path.write_text(yaml.safe_dump(content))
    return path


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
