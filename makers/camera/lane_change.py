"""Fifteen seconds of a Japanese expressway with one lane change to the right, three pictures a
second, seen past a mirror and another camera on the dashboard. No calibration comes with it: the
camera is calibrated from the lines of the pictures themselves.

Settings in sight of these pictures: block markings half a metre wide and as long as the gaps
between them need a wider top-hat (`marking_width_m`, `paint_width_m`), and in so small a picture
they run into one another, so that paint is what is half as bright as the blocks (`paint_share`).
The road has three lanes at first, the left one behind the block markings: n = 3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from egolane_pgm.types import LineLog
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from makers._running import run_of
from makers.camera._following import (
    ZERO_LABEL,
    Followed,
    calibrate,
    data_path,
    follow,
    runs,
)

#: Frames per second of the numbers in the pictures' names.
RATE = 30.0
N_LANES = 3
LANE_WIDTH_M = 3.5

#: Mirror, the other camera, dashboard: left, top, right, bottom.
HIDDEN = ("0 0 692 130", "120 300 400 480", "0 360 692 480")

SETTINGS = {
    "marking_width_m": 0.9,
    "paint_width_m": 0.9,
    "paint_share": 0.5,
    "continuous_cover": 0.65,
}

#: Detected lane changes to the left and to the right, and the assigned lanes, of both graphs.
CHANGES_AND_LANES = (
    "changes detected left, right, the paper's graph",
    "its lanes",
    "changes detected left, right, zero labels",
    "its lanes",
)


@dataclass(frozen=True)
class Crossing:
    """A tracked line that crossed from right to left of the car: its offset in the first and the
    last tracked frame, metres, and the frame from which on it was left."""

    first_m: float
    last_m: float
    crossed_at: int


def data() -> Path | None:
    """The folder, or None if it is absent."""
    return data_path("camera/lane_change_right")


@cache
def camera_of(folder: Path) -> Camera:
    """Calibrated by the command from the lines it finds in the first pictures."""
    masks = [word for hidden in HIDDEN for word in ("--ignore", *hidden.split())]
    with TemporaryDirectory() as place:
        return calibrate(
            Path(place) / "camera.yaml",
            *(folder / "*.jpg", "--lane-width", LANE_WIDTH_M, "--roll", -1.5),
            *masks,
        )


@cache
def follow_pictures(folder: Path, curve: str = "clothoid") -> Followed:
    """The detector over the pictures, the camera calibrated from the first of them."""
    camera = camera_of(folder)
    return follow(read_pictures(open_source(folder), camera), camera, curve, **SETTINGS)


def crossings(followed: Followed) -> Iterator[Crossing]:
    """The valid lines that changed sides for good, more than half a metre to either side."""
    offsets: dict[int, list[tuple[int, float]]] = {}
    was_valid: set[int] = set()
    for frame, tracks in zip(followed.frame_id, followed.tracks, strict=True):
        for number, mean, valid in zip(tracks.number, tracks.mean, tracks.is_valid, strict=True):
            offsets.setdefault(int(number), []).append((frame, float(mean[0])))
            if valid:
                was_valid.add(int(number))
    for number in sorted(was_valid):
        frames, places = zip(*offsets[number], strict=True)
        if np.sign(places[0]) != np.sign(places[-1]) and min(abs(places[0]), abs(places[-1])) > 0.5:
            other = np.flatnonzero(np.sign(places) != np.sign(places[-1]))
            yield Crossing(places[0], places[-1], frames[int(other[-1]) + 1])


def changes_and_lanes(log: LineLog) -> list[str]:
    """The cells of `CHANGES_AND_LANES`: first of the paper's graph, then of the one without labels,
    the detected lane changes (`Result.events`) to the left and to the right, and its
    assigned lanes. A lane that is assigned for a moment need not give a change."""
    cells = []
    for keys in ({}, ZERO_LABEL):
        run = run_of(log, N_LANES, RATE, **keys)
        side = run.events["direction"]
        cells += [
            f"{(side < 0).sum()}, {(side > 0).sum()}",
            runs(run.frames["assigned_lane"].to_numpy()),
        ]
    return cells


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    folder = data()
    if folder is None:
        return ["A lane change: camera/lane_change_right is absent (EGOLANE_DATA)."]
    camera = camera_of(folder)
    lines = [
        "### One lane change to the right",
        "",
        f"{len(follow_pictures(folder).frame_id)} pictures, three a second; camera from their own"
        f" lines, {LANE_WIDTH_M} m apart ({camera.height_m:.2f} m high); settings for these"
        f" pictures (see the module); n = {N_LANES}.",
        "",
        f"| | tracked lines that cross | {' | '.join(CHANGES_AND_LANES)} |",
        "|---|---|---|---|---|---|",
    ]
    for name, curve in (("**mc**", "clothoid"), ("ml", "line")):
        followed = follow_pictures(folder, curve)
        crossed = "; ".join(
            f"{c.first_m:+.1f} m to {c.last_m:+.1f} m, at picture {c.crossed_at}"
            for c in crossings(followed)
        )
        cells = changes_and_lanes(followed.log(RATE))
        lines.append(f"| {name} | {crossed} | {' | '.join(cells)} |")
    return lines
