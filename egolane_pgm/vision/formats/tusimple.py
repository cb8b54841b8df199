"""TuSimple's JSON lines, which most lane detection networks can write: one picture per line,

    {"raw_file": "clips/0313-1/6040/20.jpg", "lanes": [[-2, 632, ...], ...],
     "h_samples": [240, ...]}

`lanes` has, per line, its column in each of the rows `h_samples`, negative where it is absent.
Results for the benchmark have no `h_samples`: the rows are then its own 48 or 56.
`classes` is optional and has the class of each line; 2 (solid white) and 4 (solid yellow) are
continuous. (6, a double white line, is not: another lane lies beyond it, and the flag is evidence
of the road's edge.)

A folder that is a count and has one picture is a frame of the drive in the folder above it:
`clips/0313-1/6040/20.jpg` is frame 6040 of 0313-1. Any other folder is a clip, in which the last
number of a picture's name is the frame (`frame_00042.jpg`: 42). The frame ids of a clip continue
from the clip before, and no line is followed into the next clip.

The points of a line are put on the road by the camera, and y(x) = s0 + s1 x + s2 x^2 / 2 is fitted
to them; the offset is s0. Points are weighted by the width of a pixel on the road; a prior on the
heading and curvature of a motorway keeps the offset of a far piece of a line sane. A line is
followed from frame to frame by the nearest offset; its LRI counts in how many of the last ten
pictures it was seen (the paper's k).
"""

from __future__ import annotations

import json
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from egolane_pgm.recordings import known_formats
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import BoolArray, FloatArray, InputError, LineLog, clip_slices
from egolane_pgm.vision.camera.model import Camera, image_to_road, read_camera
from egolane_pgm.vision.detectors import fit_shape
from egolane_pgm.vision.detectors.simple.tracking import closest

#: The rows of the benchmark's pictures (1280 x 720), by their number; its results lack h_samples.
_ROWS = {48: list(range(240, 720, 10)), 56: list(range(160, 720, 10))}

#: The classes of continuous lines.
_SOLID = (2, 4)

#: The paper's k, frames: the LRI at which a line becomes valid.
LRI_FRAMES = 10

#: A valid line stays valid until its LRI falls below this, frames.
RELEASE_LRI = 5.0

#: Points farther ahead are left out, metres: a pixel is metres long there, and roads are not flat.
FARTHEST_M = 50.0

#: A line whose nearest point is farther ahead has no offset, metres.
NEAREST_M = 25.0

#: Standard deviation of a point in the fit, pixels.
POINT_PX = 3.0

#: Standard deviation of heading in the fit, radians.
HEADING = 0.1

#: Standard deviation of curvature in the fit, 1/m.
CURVATURE = 0.002

#: Largest move of a line between two pictures, metres, ...
GATE_M = 0.3

#: ... plus this for each second between them, metres per second.
GATE_M_PER_S = 1.5

#: After a gap of more seconds than this no line is followed any further.
LONGEST_GAP_S = 1.0

#: A number in a name with more digits is a time stamp, not a frame number.
_COUNT_DIGITS = 12

#: A number with more digits does not fit a frame id.
_ID_DIGITS = 18


@dataclass(frozen=True)
class ImageLine:
    """One line: its points u, v (P,) in pixels, and whether it is known to be continuous."""

    u: FloatArray
    v: FloatArray
    is_continuous: bool = False


#: The place in the file, for messages, and the lines of a picture.
_Frame = tuple[str, list[ImageLine]]


def read_tusimple(
    path: str | Path,
    *,
    frame_rate: float = 10.0,
    camera: Camera | str | Path | None = None,
) -> LineLog:
    """Read the lines of a TuSimple label or result file, T frames of at most L lines.

    - frame_rate: frames per second, counted in frame ids.
    - camera: the camera of the pictures, or its YAML file.

    A line becomes valid once it is seen in ten pictures, as in the paper; of clips of which none
    has ten pictures, every line is valid, with a warning. Another warns of pictures too far
    apart to follow a line. Raises InputError, with the line of the file, for another file, for
    frames given twice, and if the camera or all frames are missing.
    """
    path = Path(path)
    entries = list(read_entries(path))
    if camera is None:
        raise InputError(
            f"{path}: its lines are in pixels: name the camera's YAML file (recording.camera, or"
            " camera; `egolane calibrate` makes one)"
        )
    seen_by = camera if isinstance(camera, Camera) else read_camera(camera)
    if not entries:
        raise InputError(f"{path}: no frame in it")
    return _log(_clips(entries), seen_by, frame_rate, str(path))


def read_entries(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """The place in the file, for messages, and the entry of each picture. Raises InputError, naming
    the place, for another line."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        where = f"{path}: line {number}"
        try:
            entry = json.loads(line)
        except ValueError as error:
            raise InputError(
                f"{where}: is not JSON, which TuSimple's format needs in each line: {error}"
                f" (formats: {known_formats()})"
            ) from None
        for key, kind in (("raw_file", str), ("lanes", list)):
            if not isinstance(entry, dict) or not isinstance(entry.get(key), kind):
                raise InputError(
                    f"{where}: has no {key} ({kind.__name__}), which TuSimple's format needs"
                )
        if "h_samples" not in entry:
            # Results for the benchmark have its own rows, chosen by their number.
            counts = [len(lane) for lane in entry["lanes"] if isinstance(lane, list)]
            entry["h_samples"] = _ROWS.get(max(counts, default=0), [])
        yield where, entry


def entry_lines(entry: dict[str, Any], where: str) -> list[ImageLine]:
    """The lines of a picture's entry that have at least one point. Raises InputError as
    `read_tusimple` does."""
    rows = _numbers(entry["h_samples"], where, "h_samples")
    classes = entry.get("classes", [0] * len(entry["lanes"]))
    if not isinstance(classes, list) or len(classes) != len(entry["lanes"]):
        raise InputError(
            f"{where}: classes needs one class for each of {len(entry['lanes'])} lanes"
        )
    lines = []
    for k, lane in enumerate(entry["lanes"]):
        columns = _numbers(lane, where, f"lane {k + 1}")
        if len(columns) != len(rows):
            raise InputError(
                f"{where}: lane {k + 1} has {len(columns)} values for {len(rows)} h_samples"
            )
        is_there = columns >= 0
        if is_there.any():
            lines.append(ImageLine(columns[is_there], rows[is_there], classes[k] in _SOLID))
    return lines


def _numbers(values: object, where: str, what: str) -> FloatArray:
    """A list of numbers as an array. Raises InputError for anything else."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.full((1, 1), np.nan)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise InputError(f"{where}: {what} is not a list of numbers")
    return array


# --- frames and clips ----------------------------------------------------------------------------


def _clips(entries: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, dict[int, _Frame]]:
    """The frames of each clip by their numbers, ascending."""
    pictures = [PurePosixPath(entry["raw_file"]) for _, entry in entries]
    held = Counter(picture.parent for picture in set(pictures))
    clips: dict[str, dict[int, _Frame]] = {}
    for picture, (where, entry) in zip(pictures, entries, strict=True):
        folder = picture.parent
        is_frame = folder.name.isdecimal() and len(folder.name) <= _COUNT_DIGITS
        if is_frame and held[folder] == 1:
            clip = str(folder.parent)
            name = folder.name
        else:
            clip = str(folder)
            name = picture.stem
        digits = re.findall(r"\d+", name)
        if not digits or len(digits[-1]) > _ID_DIGITS:
            raise InputError(f"{where}: '{name}' has no frame number in it")
        number = int(digits[-1])
        members = clips.setdefault(clip, {})
        if number in members:
            raise InputError(
                f"{where}: frame {number} is there twice (also {members[number][0]}); keep one"
            )
        members[number] = (where, entry_lines(entry, where))
    return {clip: dict(sorted(members.items())) for clip, members in clips.items()}


def _log(
    clips: dict[str, dict[int, _Frame]],
    camera: Camera,
    frame_rate: float,
    source: str,
) -> LineLog:
    """Make one log of the clips, the lines of a frame left to right."""
    numbers: list[int] = []
    for members in clips.values():
        # With several clips the ids start at 0 and continue from clip to clip.
        shift = (numbers[-1] + 1 if numbers else 0) - min(members) if len(clips) > 1 else 0
        numbers += [k + shift for k in members]
    ids = np.array(numbers, dtype=np.int64)
    offsets = []
    flags = []
    frames = [lines for members in clips.values() for _, lines in members.values()]
    for lines in frames:
        offset = np.array([offset_of(line, camera) for line in lines])
        continuous = np.array([line.is_continuous for line in lines], dtype=bool)
        order = np.argsort(offset, kind="stable")[: np.isfinite(offset).sum()]
        offsets.append(offset[order])
        flags.append(continuous[order])
    if not any(map(len, offsets)) and any(map(len, frames)):
        raise InputError(
            f"{source}: no line has two points on the road within {NEAREST_M:.0f} m ahead of this"
            " camera; is it the camera of these pictures?"
        )
    names = np.repeat(list(clips), list(map(len, clips.values())))
    lri = []
    is_valid = []
    for piece in clip_slices(names):
        counts, flag = persistence(offsets[piece], ids[piece] / frame_rate)
        lri += counts
        is_valid += flag
    all_lri = np.concatenate(lri)
    all_valid = np.concatenate(is_valid)
    doubt = ""
    apart = float(np.median(np.diff(ids))) / frame_rate if len(ids) > 1 else 0.0
    if len(clips) > 1 and max(map(len, clips.values())) < LRI_FRAMES:
        all_lri = np.full(len(all_lri), float(LRI_FRAMES))
        all_valid = np.ones_like(all_valid)
        doubt = (
            f"its {len(clips)} clips have fewer than {LRI_FRAMES} pictures, too few to follow a"
            " line: every line counts as valid"
        )
    elif apart > LONGEST_GAP_S:
        doubt = (
            f"the pictures are {apart:.1f} s apart, too far to follow a line: none becomes valid"
            " (is recording.frame_rate right?)"
        )
    if doubt:
        warnings.warn(f"{source}: {doubt}", stacklevel=3)
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
    return replace(log, clip=names if len(clips) > 1 else None)


# --- lines ---------------------------------------------------------------------------------------


def offset_of(line: ImageLine, camera: Camera) -> float:
    """The offset of the line, metres to the right; NaN if fewer than two of its points lie on the
    road near enough."""
    x, y = image_to_road(camera, line.u, line.v)
    with np.errstate(invalid="ignore"):
        near = (x > 0) & (x <= FARTHEST_M) & np.isfinite(y)
    x = x[near]
    y = y[near]
    if len(np.unique(x)) < 2 or x.min() > NEAREST_M:
        return float("nan")
    return float(fit_shape(x, y, POINT_PX * x / camera.fx, (np.inf, HEADING, CURVATURE))[0])


def persistence(
    offsets: Sequence[FloatArray], time_s: FloatArray
) -> tuple[list[FloatArray], list[BoolArray]]:
    """The LRI and the valid flag, by the paper's hysteresis, of the lines of each frame.

    - offsets: per frame (L,) in ascending order, metres.
    - time_s (T,): the times of the frames.
    """
    place = np.zeros(0)
    flag = np.zeros(0, dtype=bool)
    seen = np.zeros((0, LRI_FRAMES), dtype=bool)
    lri = []
    valid = []
    for t, offset in enumerate(offsets):
        gap = float(time_s[t] - time_s[t - 1]) if t else 0.0
        is_followed = seen.any(axis=1) & (gap <= LONGEST_GAP_S + 1e-9)
        place = place[is_followed]
        flag = flag[is_followed]
        seen = seen[is_followed]
        away = np.abs(np.subtract.outer(offset, place))
        track = closest(np.where(away <= GATE_M + GATE_M_PER_S * gap, away, np.inf))
        is_new = track < 0
        track[is_new] = len(place) + np.arange(is_new.sum())
        place = np.append(place, offset[is_new])
        place[track] = offset
        seen = np.pad(seen, ((0, is_new.sum()), (0, 0)))
        seen = np.column_stack([seen[:, 1:], np.isin(np.arange(len(place)), track)])
        count = seen.sum(axis=1)
        # In the first frames of a drive too few pictures were seen to trust a line.
        flag = np.append(flag, is_new[is_new]) & (count >= RELEASE_LRI) | (count == LRI_FRAMES)
        lri.append(count[track].astype(np.float64))
        valid.append(flag[track])
    return lri, valid
