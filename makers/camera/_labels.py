"""Hand labels of lines in TuSimple's format: points, pictures, and places on the road."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.formats.tusimple import entry_lines, read_entries

#: Labels reach to the horizon; a pixel there is many metres.
_FARTHEST_M = 40.0


def read_labels(path: Path) -> list[dict[str, Any]]:
    """A mapping for each frame of a file."""
    return [entry for _, entry in read_entries(path)]


def line_points(frame: dict[str, Any]) -> list[FloatArray]:
    """The points (N, 2) of each line of a frame, pixels."""
    return [np.stack([line.u, line.v], axis=-1) for line in entry_lines(frame, "labels")]


def label_picture(frame: dict[str, Any], labels: Path) -> Path:
    """The picture of a frame, in the folder of its label."""
    named = labels.parent / frame.get("image", frame.get("raw_file"))
    return named if named.is_file() else labels.parent / frame["raw_file"].removeprefix("clips/")


def label_places(camera: Camera, frame: dict[str, Any], ahead_m: float) -> FloatArray:
    """Offsets of the lines of a frame `ahead_m` metres ahead, (A,), metres to the right.

    A label's points are brought onto the road and joined by straight lines. A label that ends
    before `ahead_m` is continued by the straight line through the six nearest points; one with
    fewer than three points on the nearer 40 m of the road is left out.
    """
    places = []
    for points in line_points(frame):
        x, y = image_to_road(camera, points[:, 0], points[:, 1])
        seen = np.isfinite(x) & (x < _FARTHEST_M)
        x, y = x[seen], y[seen]
        if len(x) < 3:
            continue
        order = np.argsort(x)
        if x.min() <= ahead_m <= x.max():
            places.append(float(np.interp(ahead_m, x[order], y[order])))
        else:
            nearest = np.argsort(np.abs(x - ahead_m))[:6]
            fitted = np.polyfit(x[nearest], y[nearest], 1)
            places.append(float(np.polyval(fitted, ahead_m)))
    return np.array(places, dtype=np.float64)
