"""A second and a half of motorway in the leftmost lane, calibrated as a user does it: the lens from
17 chessboards, the camera's turn and height from two stills of a straight road.

In-sample in one respect: `_paint` was chosen on other pictures, with these in sight. The road has
four lanes or more; the belief is given n = 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from makers._running import run_of
from makers.camera._following import (
    ZERO_LABEL,
    Followed,
    calibrate,
    data_path,
    follow,
    mirrored,
    runs,
)

LANE_WIDTH_M = 3.7
RATE = 25.0
N_LANES = 4

#: The bonnet begins in this row.
BONNET = 670

#: With half the picture black, what is seen this near the car's middle is not of the left half.
EDGE_M = 0.6

#: From here on the belief is asked for, seconds.
FROM_S = 0.5


@dataclass(frozen=True)
class EgoLane:
    """The lines next to the car, T frames. left_m, right_m (T,): offsets, NaN where there is none.
    is_left_continuous, is_right_continuous (T,). lane, lane_zero (T,): assigned by the paper's
    graph and by the one without labels."""

    left_m: FloatArray
    right_m: FloatArray
    is_left_continuous: BoolArray
    is_right_continuous: BoolArray
    lane: IntArray
    lane_zero: IntArray

    @property
    def width_m(self) -> FloatArray:
        """(T,)."""
        return self.right_m - self.left_m


def data() -> Path | None:
    """The folder, or None if it is absent."""
    return data_path("camera/carnd")


@cache
def camera_of(folder: Path) -> Camera:
    """Calibrated by the command, from chessboards and the two stills of straight road."""
    with TemporaryDirectory() as place:
        return calibrate(
            Path(place) / "camera.yaml",
            folder / "test_images" / "straight_lines*.jpg",
            *("--chessboards", folder / "camera_cal" / "*.jpg"),
            *("--lane-width", LANE_WIDTH_M, "--ignore", 0, BONNET, 1280, 720),
        )


def follow_video(
    folder: Path, change: Callable[[Image], Image] | None = None, flip: bool = False
) -> Followed:
    """The clothoid detector over the video. change: of each picture; flip: the camera of mirrored
    pictures."""
    camera = camera_of(folder)
    source = open_source(folder / "test_video.mp4")
    pictures = read_pictures(source, camera)
    if change is not None:
        pictures = (Picture(p.frame_id, change(p.image)) for p in pictures)
    return follow(pictures, mirrored(camera) if flip else camera)


def ego_lane(log: LineLog) -> EgoLane:
    """The lines next to the car and the belief."""
    rows = np.arange(len(log))
    offset = log.offset_m
    left = np.where(offset < 0, offset, -np.inf).argmax(axis=1)
    right = np.where(offset > 0, offset, np.inf).argmin(axis=1)
    has_left, has_right = (offset < 0).any(axis=1), (offset > 0).any(axis=1)
    return EgoLane(
        np.where(has_left, offset[rows, left], np.nan),
        np.where(has_right, offset[rows, right], np.nan),
        log.is_continuous[rows, left] & has_left,
        log.is_continuous[rows, right] & has_right,
        run_of(log, N_LANES, RATE).frames["assigned_lane"].to_numpy(),
        run_of(log, N_LANES, RATE, **ZERO_LABEL).frames["assigned_lane"].to_numpy(),
    )


def as_it_is(folder: Path) -> EgoLane:
    """The video as it is."""
    return ego_lane(follow_video(folder).log(RATE))


def left_to_right(folder: Path) -> EgoLane:
    """Mirrored, the camera too."""
    turned = follow_video(folder, lambda image: np.ascontiguousarray(image[:, ::-1]), flip=True)
    return ego_lane(turned.log(RATE))


def left_blanked(folder: Path) -> Followed:
    """The left half of every picture black."""

    def blanked(image: Image) -> Image:
        dark = image.copy()
        dark[:, : image.shape[1] // 2] = 0
        return dark

    return follow_video(folder, blanked)


def frames_with_left_line(followed: Followed) -> tuple[int, int, int]:
    """In how many frames there is a line left of the car, valid or not; a valid one; and one that
    is not near the car's middle, valid or not."""
    any_line = sum(bool((f.offset_m < 0).any()) for f in followed.lines)
    valid = sum(bool((f.offset_m[f.is_valid] < 0).any()) for f in followed.lines)
    return any_line, valid, sum(bool((f.offset_m < -EDGE_M).any()) for f in followed.lines)


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    folder = data()
    if folder is None:
        return ["Motorway in the leftmost lane: camera/carnd is absent (EGOLANE_DATA)."]
    camera = camera_of(folder)
    plain, mirror, blank = as_it_is(folder), left_to_right(folder), left_blanked(folder)
    n = len(plain.lane)
    start = round(FROM_S * RATE)
    lines = [
        "### A video in the leftmost lane",
        "",
        f"{n} frames, detector mc with its defaults, camera by `egolane calibrate` from chessboards"
        f" and two stills ({camera.height_m:.2f} m high, pitch {camera.pitch_deg:.1f} degrees)."
        f" Belief with n = {N_LANES}, from {FROM_S} s on ({n - start} frames).",
        "",
        "| | as it is | mirrored left to right |",
        "|---|---|---|",
    ]
    both = [
        f"{(np.isfinite(lane.left_m) & np.isfinite(lane.right_m)).sum()} of {n}"
        for lane in (plain, mirror)
    ]
    lines.append(f"| frames with both lines of the ego lane | {' | '.join(both)} |")
    widths = [
        f"{np.nanmean(lane.width_m):.2f} m (sd {np.nanstd(lane.width_m):.2f},"
        f" {np.nanmin(lane.width_m):.2f} to {np.nanmax(lane.width_m):.2f})"
        for lane in (plain, mirror)
    ]
    lines.append(f"| lane width | {' | '.join(widths)} |")
    kinds = [
        f"{lane.is_left_continuous.mean():.0%}, {lane.is_right_continuous.mean():.0%}"
        for lane in (plain, mirror)
    ]
    lines.append(f"| left, right line continuous | {' | '.join(kinds)} |")
    for name, lanes in (
        ("the paper's graph", (plain.lane, mirror.lane)),
        ("zero labels", (plain.lane_zero, mirror.lane_zero)),
    ):
        lines.append(f"| lane, {name} | {' | '.join(runs(lane[start:]) for lane in lanes)} |")
    some, valid, far = frames_with_left_line(blank)
    lines += [
        "",
        f"With the left half of every picture black: a line more than {EDGE_M} m left of the car,"
        f" valid or not, in {far} of {n} frames; something nearer is followed in {some},"
        f" and valid in {valid}.",
    ]
    return lines
