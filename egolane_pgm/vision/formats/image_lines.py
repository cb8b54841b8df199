"""Lines in pixels as a recording: points in the picture become offsets at the car, and the
persistence of a line over the frames its LRI.

The points of a line are put on the road by the camera and y(x) = s0 + s1 x + s2 x^2 / 2 is fitted
to the points at most `FARTHEST_M` ahead. The offset is s0, where the line passes the camera, or
y(`ahead_m`). The fit trusts a point as far as a pixel is wide on the road where it lies, and
expects the heading and curvature of a motorway, so that a line of which only a far piece is seen
does not get an absurd offset.

A line is followed from frame to frame by the nearest offset. Its LRI is the share of the last
`LRI_FRAMES` pictures, the frame's own included, in which it was seen, times `LRI_FRAMES` (the
paper's count, section `section:simple-line-detector`). Frames whose number is missing are neither
seen nor missed; after a gap longer than `LONGEST_GAP_S` every line begins anew.

Data sets mostly are many short clips. Those of one file or folder become one recording, clip after
clip: the frame ids of a clip go on after those of the clip before, and no line is followed from one
into the next.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.types import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LineLog,
    not_one_of,
    pieces_of,
)
from egolane_pgm.vision.camera.model import Camera, image_to_road, read_camera

#: The paper's k.
LRI_FRAMES = 10

#: A line becomes valid at LRI = LRI_FRAMES and stays so until its LRI falls below this.
RELEASE_LRI = 5.0

#: Points further ahead are left out: a pixel is metres long there and roads are not flat.
FARTHEST_M = 50.0

#: A line whose nearest point is further ahead than this has no offset: it says too little.
NEAREST_M = 25.0

#: Standard deviations of the fit: of a point, pixels; of heading, radians; of curvature, 1/m.
POINT_PX, HEADING, CURVATURE = 3.0, 0.1, 0.002

#: How far a line may move between two pictures: metres, and metres for each second between them.
GATE_M, GATE_M_PER_S = 0.3, 1.5

#: After a gap of more seconds than this no line is followed any further.
LONGEST_GAP_S = 1.0

#: How a line becomes valid: by the paper's hysteresis, or always, where the source is trusted.
VALID = ("hysteresis", "always")

#: A number in a picture's name with more digits is a time stamp, which counts nothing.
COUNT_DIGITS = 12


@dataclass(frozen=True)
class ImageLine:
    """One line: its points u, v (P,) in pixels, and whether it is known to be continuous."""

    u: FloatArray
    v: FloatArray
    is_continuous: bool = False


@dataclass(frozen=True)
class ImageFrame:
    """The lines of one picture.

    - name: what its frame number stands in.
    - where: its place in the file, for messages.
    - clip: the clip, or drive, that it is of.
    """

    name: str
    lines: Sequence[ImageLine]
    where: str
    clip: str = ""


def line_log(
    frames: Sequence[ImageFrame],
    *,
    camera: Camera,
    frame_rate: float,
    valid: str | None,
    frame_step: int,
    ahead_m: float,
    source: str,
) -> LineLog:
    """Put the frames in order, clip after clip, and make a LineLog of them, lines left to right.

    - frame_step: the difference between the numbers of neighbouring frames; frame id is number over
      frame_step. Of several clips the ids start at 0 and go on from clip to clip.
    - valid: one of VALID; with "always" every line has the highest LRI too. None is "hysteresis",
      but for clips that are all too short for it.
    - ahead_m: how far ahead of the camera offsets are measured, metres.

    Warns of clips that are too short, and pictures too far apart, to follow a line. Raises
    InputError for frames that occur twice in a clip, numbers that frame_step does not divide,
    points outside of what the camera takes, and where no point at all lies below the horizon.
    """
    _check_options(valid, frame_step, ahead_m, source)
    ids, ordered, clip = _in_order(frames, frame_step, source)
    _check_rows(ordered, camera)
    offsets, flags = [], []
    for frame in ordered:
        offset = np.array([offset_of(line, camera, ahead_m) for line in frame.lines])
        continuous = np.array([line.is_continuous for line in frame.lines], dtype=bool)
        order = np.argsort(offset, kind="stable")[: np.isfinite(offset).sum()]
        offsets.append(offset[order])
        flags.append(continuous[order])
    if not any(map(len, offsets)) and any(len(frame.lines) for frame in ordered):
        raise InputError(
            f"{source}: no line has two points on the road within {NEAREST_M:.0f} m ahead of this"
            " camera; is it the camera of these pictures?"
        )
    lri, is_valid = [], []
    pieces = pieces_of(clip, len(ids))
    for piece in pieces:
        counts, flag = persistence(offsets[piece], ids[piece] / frame_rate)
        lri += counts
        is_valid += flag
    all_lri, all_valid = np.concatenate(lri), np.concatenate(is_valid)
    if valid is None and len(pieces) > 1 and max(p.stop - p.start for p in pieces) < LRI_FRAMES:
        valid = "always"
        _warn(
            f"{source}: its {len(pieces)} clips have fewer than {LRI_FRAMES} pictures, too few to"
            " follow a line: every line counts as valid (recording.options.valid: hysteresis says"
            " otherwise)"
        )
    if valid == "always":
        all_lri, all_valid = np.full(len(all_lri), float(LRI_FRAMES)), np.ones_like(all_valid)
    apart = float(np.median(np.diff(ids))) / frame_rate if len(ids) > 1 else 0.0
    if valid != "always" and apart > LONGEST_GAP_S:
        _warn(
            f"{source}: the pictures are {apart:.1f} s apart, too far to follow a line: none"
            " becomes valid (are recording.frame_rate and recording.options.frame_step right?"
            " options.valid: always trusts every line)"
        )
    log = LineLog.from_rows(
        ids,
        frame_rate,
        np.repeat(np.arange(len(ids)), [len(row) for row in offsets]),
        np.concatenate(offsets),
        all_valid,
        np.concatenate(flags),
        all_lri,
        source=source,
    )
    return replace(log, clip=clip)


def _warn(message: str) -> None:
    warnings.warn(message, UserWarning, stacklevel=4)


def offset_of(line: ImageLine, camera: Camera, ahead_m: float = 0.0) -> float:
    """The offset of the line, metres to the right, `ahead_m` ahead of the camera; NaN if fewer
    than two of its points lie on the road near enough."""
    x, y = image_to_road(camera, line.u, line.v)
    with np.errstate(invalid="ignore"):
        near = (x > 0) & (x <= FARTHEST_M) & np.isfinite(y)
    x, y = x[near], y[near]
    if len(np.unique(x)) < 2 or x.min() > NEAREST_M:
        return float("nan")
    prior = np.diag([0.0, 1 / HEADING, 1 / CURVATURE])[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        weight = camera.fx / (POINT_PX * x)
        rows = np.stack([np.ones_like(x), x, x * x / 2], axis=1) * weight[:, None]
        design = np.concatenate([rows, prior])
        values = np.concatenate([y * weight, np.zeros(len(prior))])
    if not (np.isfinite(design).all() and np.isfinite(values).all()):
        return float("nan")
    shape = np.linalg.lstsq(design, values, rcond=None)[0]
    return float(shape @ [1.0, ahead_m, ahead_m**2 / 2])


@dataclass
class _Track:
    offset: float
    history: list[bool]
    is_valid: bool = False


def persistence(
    offsets: Sequence[FloatArray], time_s: FloatArray
) -> tuple[list[FloatArray], list[BoolArray]]:
    """The LRI and the valid flag, by the paper's hysteresis, of the lines of each frame.

    - offsets: per frame (L,) in ascending order, metres.
    - time_s (T,): the times of the frames.
    """
    tracks: list[_Track] = []
    lri, valid = [], []
    for t, offset in enumerate(offsets):
        gap = float(time_s[t] - time_s[t - 1]) if t else 0.0
        if gap > LONGEST_GAP_S + 1e-9:
            tracks = []
        matched = _nearest([track.offset for track in tracks], offset, GATE_M + GATE_M_PER_S * gap)
        for k, track in enumerate(tracks):
            track.history = [*track.history, k in matched.values()][-LRI_FRAMES:]
        own = []
        for line, value in enumerate(offset):
            if line in matched:
                own.append(tracks[matched[line]])
                own[-1].offset = float(value)
            else:
                own.append(_Track(float(value), [True]))
                tracks.append(own[-1])
        for track in tracks:
            seen = sum(track.history)
            # In the first frames of a drive too few pictures were seen to trust a line.
            track.is_valid = seen == LRI_FRAMES or (track.is_valid and seen >= RELEASE_LRI)
        tracks = [track for track in tracks if any(track.history)]
        lri.append(np.array([float(sum(track.history)) for track in own]))
        valid.append(np.array([track.is_valid for track in own], dtype=bool))
    return lri, valid


def _nearest(before: Sequence[float], now: FloatArray, gate: float) -> dict[int, int]:
    """Line -> track for the pairs nearer than the gate, nearest first, each used once."""
    distance = np.abs(np.subtract.outer(np.asarray(now), np.asarray(before)))
    pairs: dict[int, int] = {}
    for flat in np.argsort(distance, axis=None, kind="stable"):
        line, track = divmod(int(flat), len(before))
        if distance[line, track] > gate:
            break
        if line not in pairs and track not in pairs.values():
            pairs[line] = track
    return pairs


# --- what the files say of frames and cameras ----------------------------------------------------


def camera_of(camera: Camera | str | Path | None, source: Path) -> Camera:
    """The given camera, read if it is a file. Raises InputError if there is none."""
    if camera is None:
        raise InputError(
            f"{source}: its lines are in pixels: name the camera's YAML file (recording.camera, or"
            " camera; `egolane calibrate` makes one)"
        )
    if not isinstance(camera, (Camera, str, Path)):
        raise InputError(f"{source}: camera: {camera!r} is not the name of a camera's YAML file")
    return camera if isinstance(camera, Camera) else read_camera(camera)


def frame_number(name: str, source: str) -> int:
    """The frame number in a name: the last run of digits in it. Raises InputError for a name
    without a number, or with a time stamp."""
    digits = re.findall(r"\d+", name)
    if not digits:
        raise InputError(f"{source}: '{name}' has no frame number in it")
    if len(digits[-1]) > COUNT_DIGITS:
        raise InputError(
            f"{source}: '{name}' is named by a time stamp; name the pictures by frame numbers"
        )
    return int(digits[-1])


def _check_options(valid: str | None, frame_step: int, ahead_m: float, source: str) -> None:
    if valid is not None and valid not in VALID:
        raise InputError(f"{source}: valid: {not_one_of(valid, VALID)}")
    if isinstance(frame_step, bool) or not isinstance(frame_step, int) or frame_step < 1:
        raise InputError(f"{source}: frame_step: {frame_step!r} is not a whole number from 1 up")
    is_number = isinstance(ahead_m, (int, float)) and not isinstance(ahead_m, bool)
    if not (is_number and 0 <= ahead_m <= NEAREST_M):
        raise InputError(f"{source}: ahead_m: {ahead_m!r} is not between 0 and {NEAREST_M:.0f} m")


def _in_order(
    frames: Sequence[ImageFrame], frame_step: int, source: str
) -> tuple[IntArray, list[ImageFrame], NDArray[np.str_] | None]:
    """The frame ids, (T,), and the frames; and of several clips the name of each frame's, (T,)."""
    clips: dict[str, list[ImageFrame]] = {}
    for frame in frames:
        clips.setdefault(frame.clip, []).append(frame)
    if not clips:
        raise InputError(f"{source}: no frame in it")
    ids: list[int] = []
    ordered: list[ImageFrame] = []
    for members in clips.values():
        by_id = _numbered(members, frame_step, source)
        after = ids[-1] + 1 if ids else 0
        shift = after - min(by_id) if len(clips) > 1 else 0
        ids += [k + shift for k in sorted(by_id)]
        ordered += [by_id[k] for k in sorted(by_id)]
    names = np.array([frame.clip for frame in ordered]) if len(clips) > 1 else None
    return np.array(ids, dtype=np.int64), ordered, names


def _numbered(frames: Sequence[ImageFrame], frame_step: int, source: str) -> dict[int, ImageFrame]:
    """The frames of one clip by their numbers over frame_step."""
    by_id: dict[int, ImageFrame] = {}
    for frame in frames:
        number = frame_number(frame.name, source)
        if number % frame_step:
            raise InputError(
                f"{frame.where}: frame {number} is no multiple of frame_step {frame_step}"
            )
        k = number // frame_step
        if k in by_id:
            raise InputError(
                f"{frame.where}: frame {number} is there twice (also {by_id[k].where}); keep"
                " one of them"
            )
        by_id[k] = frame
    return by_id


def _check_rows(frames: Iterable[ImageFrame], camera: Camera) -> None:
    """Raise InputError if lines reach far below the camera's picture: then they are of another
    camera."""
    for frame in frames:
        lowest = max((float(line.v.max()) for line in frame.lines if len(line.v)), default=0.0)
        if lowest > 1.1 * camera.height:
            raise InputError(
                f"{frame.where}: a line reaches down to row {lowest:.0f}, the camera's pictures"
                f" have {camera.height}; is it the camera of these pictures?"
            )


def points(values: object, where: str, what: str) -> FloatArray:
    """A list of numbers as an array. Raises InputError for anything else."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros((0, 0))
    if array.ndim != 1 or not isinstance(values, list) or any(isinstance(v, bool) for v in values):
        raise InputError(f"{where}: {what} is not a list of numbers")
    if not np.isfinite(array).all():
        raise InputError(f"{where}: {what} has a number that is not finite")
    return array
