"""A road's lines in TuSimple's format."""

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
