"""Data, calibration by the command, and lines tracked over a drive."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

from egolane_pgm.command import egolane
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import IntArray, LineLog
from egolane_pgm.vision.camera.model import Camera, read_camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, as_log
from egolane_pgm.vision.detectors.simple.finder import MONO, follower
from egolane_pgm.vision.detectors.simple.tracking import Tracks, lines_of, no_tracks


def data_path(name: str) -> Path | None:
    """A file or folder of $EGOLANE_DATA, or None if it is absent."""
    data = os.environ.get("EGOLANE_DATA")
    path = Path(data) / name if data else None
    return path if path is not None and path.exists() else None


def calibrate(target: Path, *words: object) -> Camera:
    """The camera that `egolane calibrate words` writes to target, without its output."""
    given = ["calibrate", *map(str, words), "--out", str(target)]
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        egolane.main(given, standalone_mode=False)
    return read_camera(target)


@dataclass(frozen=True)
class Followed:
    """Frame ids, lines and tracks of a drive, frame by frame."""

    frame_id: tuple[int, ...]
    lines: tuple[FrameLines, ...]
    tracks: tuple[Tracks, ...]

    def log(self, frame_rate: float) -> LineLog:
        """As a recording."""
        return as_log(zip(self.frame_id, self.lines, strict=True), frame_rate, "pictures")


def follow(
    pictures: Iterable[Picture], camera: Camera, curve: str = "clothoid", **given: Any
) -> Followed:
    """The detector ML ("line") or MC ("clothoid") over the pictures of a drive."""
    step, rule = follower(camera, resolve_parameters(MONO, given, 1), curve=curve)
    tracks = no_tracks(rule)
    ids, lines, history = [], [], []
    for picture in pictures:
        tracks = step(tracks, picture)
        ids.append(picture.frame_id)
        lines.append(lines_of(tracks, rule))
        history.append(tracks)
    return Followed(tuple(ids), tuple(lines), tuple(history))


#: Position in lane with generic constants: the graph for a drive without labels.
ZERO_LABEL = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}


def mirrored(camera: Camera) -> Camera:
    """The camera whose pictures are this one's, mirrored left to right."""
    k1, k2, p1, p2, k3 = camera.distortion
    width = camera.width
    return replace(
        camera,
        cx=width - 1 - camera.cx,
        yaw_deg=-camera.yaw_deg,
        roll_deg=-camera.roll_deg,
        lateral_m=-camera.lateral_m,
        distortion=(k1, k2, p1, -p2, k3),
        ignore=tuple(
            (width - right, top, width - left, bottom) for left, top, right, bottom in camera.ignore
        ),
    )


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share of independent trials."""
    z = 1.959963984540054
    share, square = hits / of, z * z / of
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / of + square / (4 * of))
    return middle - half, middle + half


def runs(lanes: Sequence[int] | IntArray) -> str:
    """`2 x 41, 3 x 9` of a sequence of lanes."""
    words: list[tuple[int, int]] = []
    for lane in lanes:
        if words and words[-1][0] == lane:
            words[-1] = (lane, words[-1][1] + 1)
        else:
            words.append((int(lane), 1))
    return ", ".join(f"{lane or 'none'} x {n}" for lane, n in words)
