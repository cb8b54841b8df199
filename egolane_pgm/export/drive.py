"""What viewers show of a result, on one clock: beliefs, answers, lines, truth and pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.experiment import load_experiment
from egolane_pgm.results import LINES, Result, read_result
from egolane_pgm.types import (
    SIDES,
    UNASSIGNED,
    FloatArray,
    InputError,
    IntArray,
    LaneEvents,
)
from egolane_pgm.vision.camera.pictures import Source, images_of
from egolane_pgm.vision.camera.writing import as_jpeg
from egolane_pgm.vision.detectors.pictures import pictures_of

#: The place of a node's values in a viewer is a curve each; a node with more of them (the cells of
#: RoadPosition) is left out.
MOST_VALUES = 16

#: How far ahead the lines of the bird's-eye view reach: a recording has their offsets only, metres.
AHEAD_M = 40.0

#: Pictures are not higher, pixels.
PICTURE_HEIGHT = 540

#: The beliefs over lanes as bars, in the bird's-eye view behind the car: where they stand, how far
#: apart and how high certainty is, metres.
BARS_M, BAR_GAP_M, BAR_HEIGHT_M = -8.0, 2.0, 6.0

# Okabe and Ito's colours, red green blue, as in the videos.
CONTINUOUS, DASHED, NOT_VALID = (0, 114, 178), (230, 159, 0), (150, 150, 150)
ASSIGNED, OTHER, TRUTH = (0, 114, 178), (188, 215, 236), (213, 94, 0)


#: Red, green, blue.
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Drive:
    """A result as viewers show it, T frames.

    - events: the lane changes in the beliefs of the whole drive.
    - time_ns (T,): when the frames were; strictly increasing.
    - pictures: those of its camera; None where there are none.
    """

    result: Result
    events: LaneEvents
    time_ns: IntArray
    pictures: Source | None

    def __len__(self) -> int:
        return len(self.time_ns)

    def beliefs(self) -> dict[str, tuple[tuple[str, ...], FloatArray]]:
        """Per hidden node the names of its values, and the belief in each, (T, k)."""
        return {
            node: (names, self.result.marginals[node])
            for node, names in self.result.values.items()
            if len(names) <= MOST_VALUES
        }

    def lane_curves(self) -> dict[str, NDArray[np.int64]]:
        """The lanes over time by name, (T,), 0 for Unassigned or not annotated."""
        result = self.result
        curves = {"model": result.assigned_lane}
        if result.detector_lane is not None:
            curves["detector"] = result.detector_lane
        if (result.true_lane != UNASSIGNED).any():
            curves["truth"] = result.true_lane
        return curves

    def lines_at(self, t: int) -> list[tuple[float, Colour, bool, bool]]:
        """The lines of frame t from left to right: offset, colour, whether it is valid, and whether
        it is continuous."""
        if self.result.lines is None:
            return []
        offset, is_valid = self.result.lines.offset_m[t], self.result.lines.is_valid[t]
        # Some detectors write an offset of exactly 0, or of kilometres, where there is no line.
        is_line = np.isfinite(offset) & (np.abs(offset) < 100) & ((offset != 0) | is_valid)
        found = []
        for k in np.flatnonzero(is_line)[np.argsort(offset[is_line], kind="stable")]:
            is_good, is_solid = bool(is_valid[k]), bool(self.result.lines.is_continuous[t, k])
            seen = CONTINUOUS if is_solid else DASHED
            found.append((float(offset[k]), seen if is_good else NOT_VALID, is_good, is_solid))
        return found

    def bars_at(self, t: int) -> list[tuple[float, float, Colour, bool]]:
        """The bars of the belief over the lanes in frame t, lane 1 on the left: how far right a
        bar stands, metres, the belief, its colour, whether it is the true lane."""
        belief, n = self.result.marginals["Lane"][t], self.result.n_lanes
        answer, truth = int(self.result.assigned_lane[t]), int(self.result.true_lane[t])
        return [
            (
                (k - (n - 1) / 2) * BAR_GAP_M,
                float(belief[k]),
                ASSIGNED if k + 1 == answer else OTHER,
                k + 1 == truth,
            )
            for k in range(n)
        ]

    def event_texts(self) -> list[tuple[int, str]]:
        """Per reported lane change the row of the frame in which it is, and a line of text."""
        events, ids = self.events, self.result.frame_id
        names = ("told_frame_id", "from_lane", "to_lane", "probability", "direction")
        changes = zip(*(getattr(events, name) for name in names), strict=True)
        return [
            (
                int(np.searchsorted(ids, at)),
                f"lane {a} to {b}, probability {p:.2f}" if a else f"a lane {SIDES[side]}",
            )
            for at, a, b, p, side in changes
            if ids[0] <= at <= ids[-1]
        ]

    def jpegs(self) -> Iterator[tuple[int, bytes]]:
        """The row of each frame that has a picture, and its JPEG file, one at a time."""
        if self.pictures is None:
            return
        ids = self.result.frame_id
        for frame_id, _, image in images_of(self.pictures, (int(ids[0]), int(ids[-1]) + 1)):
            row = int(np.searchsorted(ids, frame_id))
            if row < len(ids) and ids[row] == frame_id:
                yield row, as_jpeg(image, PICTURE_HEIGHT)


def open_drive(directory: str | Path, frames: tuple[int, int] | None = None) -> Drive:
    """Gather what a result directory, and the recording that it names, have to show.

    - frames: the first and the last frame id; by default all.

    Lines or pictures that are not there any more are left out with a warning. Raises InputError for
    what is no result directory, frames of which the result has none, and times that do not
    increase.
    """
    result = read_result(directory)
    events = result.events
    if frames is not None:
        chosen = (result.frame_id >= frames[0]) & (result.frame_id <= frames[1])
        if not chosen.any():
            first, last = (int(result.frame_id[k]) for k in (0, -1))
            raise InputError(
                f"{result.directory}: has no frame from {frames[0]} to {frames[1]}; its"
                f" frames are {first} to {last}"
            )
        result = result.take(chosen)
    if result.lines is None:
        warnings.warn(
            f"{result.directory}: has no lines ({LINES}), shown without them; run the experiment"
            " again to have them",
            UserWarning,
            stacklevel=2,
        )
    return Drive(result, events, _clock(result), _pictures(result))


def _clock(result: Result) -> IntArray:
    # Seconds since 1970 in a float are good to a microsecond.
    whole = np.floor(result.time_s)
    part = np.round((result.time_s - whole) * 1e6).astype(np.int64) * 1000
    time_ns = whole.astype(np.int64) * 10**9 + part
    bad = (np.diff(time_ns, prepend=-1) <= 0) | (time_ns < 0)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(
            f"{result.directory}: frame {int(result.frame_id[k])} is at {result.time_s[k]:g} s,"
            " which is before 0 or not after the frame before; a viewer needs times that increase"
        )
    return time_ns


def _pictures(result: Result) -> Source | None:
    """The pictures that the result's detector looked at."""
    if (result.config.get("recording") or {}).get("detector") is None:
        return None
    try:
        return pictures_of(load_experiment(result.directory / "experiment.yaml"), "path")
    except InputError as error:
        warnings.warn(f"shown without pictures: {error}", UserWarning, stacklevel=3)
        return None
