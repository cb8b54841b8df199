"""A road's lines in TuSimple's, CULane's and OpenLane's formats."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision.camera.model import Camera, road_to_image, write_camera

CAMERA = Camera(
    width=1280, height=720, fx=1040, fy=1040, cx=640, cy=360, height_m=1.6, pitch_deg=-4, yaw_deg=1
)
ROWS = list(range(300, 720, 10))
OFFSETS = (-5.4, -1.8, 1.9)


@functools.cache
def columns(offset: float) -> list[float]:
    """Where a straight line at an offset is in each of the rows; -2 above the horizon."""
    far = np.geomspace(2, 400, 4000)[::-1]
    u, v = road_to_image(CAMERA, far, offset)
    return np.interp(ROWS, v, u, left=-2, right=-2).tolist()


def entry(number: int, offsets: Sequence[float] = OFFSETS, **more: Any) -> dict[str, Any]:
    """A line of TuSimple's format."""
    # Copies, which a test may change.
    lanes = [list(columns(offset)) for offset in offsets]
    found = {"raw_file": f"clips/0313-1/{number}/20.jpg", "lanes": lanes, "h_samples": ROWS}
    return {**found, **more}


def tusimple(path: Path, entries: Sequence[dict[str, Any]]) -> Path:
    path.write_text("".join(json.dumps(e) + "\n" for e in entries))
    return path


def culane(folder: Path, numbers: Sequence[int]) -> Path:
    folder.mkdir()
    for number in numbers:
        text = ""
        for offset in OFFSETS:
            pairs = zip(columns(offset), ROWS, strict=True)
            text += " ".join(f"{u:.3f} {v}" for u, v in pairs if u != -2) + " \n"
        (folder / f"{number:05d}.lines.txt").write_text(text)
    return folder


def openlane(folder: Path, stamps: Sequence[int], categories: Sequence[int] = (8, 1, 2)) -> Path:
    folder.mkdir()
    for stamp in stamps:
        lanes = []
        for offset, category in zip(OFFSETS, categories, strict=True):
            pairs = [(u, v) for u, v in zip(columns(offset), ROWS, strict=True) if u != -2]
            uv = [[u for u, _ in pairs], [v for _, v in pairs]]
            lanes.append({"category": category, "uv": uv, "attribute": 1, "visibility": []})
        content = {"file_path": f"training/segment-7/{stamp}.jpg", "lane_lines": lanes}
        (folder / f"{stamp}.json").write_text(json.dumps(content))
    return folder


def saved_camera(folder: Path, camera: Camera = CAMERA) -> Path:
    write_camera(folder / "cam.yaml", camera)
    return folder / "cam.yaml"


def read(path: Path, **options: Any) -> LineLog:
    return read_lines(path, **{"camera": CAMERA, **options})


def whats_wrong(path: Path, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        read(path, **options)
    said = str(caught.value)
    assert "\n" not in said
    assert said.startswith(str(path))
    return said
