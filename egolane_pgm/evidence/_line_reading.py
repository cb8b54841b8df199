"""What the line geometry takes from a log: which lines count, how they moved, lane widths."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.evidence._lane_width import LaneWidth, lane_width, widths_so_far
from egolane_pgm.evidence._line_model import LEAST_LRI, REACH_M, STRONG_LRI
from egolane_pgm.graphs._parameters import number
from egolane_pgm.graphs.position_in_lane import motion_index
from egolane_pgm.types import FloatArray, IntArray, LineLog, Parameters

#: With `lane_width_m: causal`, frames until the width is looked at again.
LOOK_AGAIN = 200


@dataclass(frozen=True)
class SeenLines:
    """A log's lines, read for the geometry.

    offset_m (T, L): 0 where there is no line. kind (T, L): the class of a line that counts, else
    -1. motion (T,): the value of LineMotion.
    """

    offset_m: FloatArray
    kind: IntArray
    motion: IntArray


def frame_widths(log: LineLog, parameters: Parameters) -> FloatArray:
    """(T,): the lane width that each frame is read with; says what was found in a warning."""
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        return np.full(len(log), number(width))
    fallback = number(parameters["fallback_width_m"])
    whole = lane_width(log, fallback)
    if width == "auto":
        _say(whole)
        return np.full(len(log), whole.width_m)
    _say(whole)
    return np.repeat(widths_so_far(log, LOOK_AGAIN, fallback), LOOK_AGAIN)[: len(log)]


def _say(found: LaneWidth) -> None:
    warnings.warn(found.message, UserWarning, stacklevel=2)


def one_width(log: LineLog, parameters: Parameters) -> float:
    """The lane width that a recording is learned from with: the given one, else that of all its
    lines. Says nothing."""
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        return number(width)
    return lane_width(log, number(parameters["fallback_width_m"])).width_m


def read_lines(
    log: LineLog, widths: FloatArray, parameters: Parameters, *, kernel: bool = True
) -> SeenLines:
    """Which lines count, and how they moved. widths (T,): lane width of each frame, metres."""
    run: Any
    if kernel:
        from egolane_pgm.evidence._line_geometry_kernel import follow_lines as run
    else:
        from egolane_pgm.evidence._line_geometry_numpy import follow_lines as run
    kind = line_classes(log)
    steps = np.ones(len(log), dtype=np.int64)
    steps[1:] = np.diff(log.frame_id)
    # A frame that was put in says nothing about motion, nor does the one after it.
    follows = (steps == 1) & ~log.is_missing
    follows[1:] &= ~log.is_missing[:-1]
    is_held = np.zeros(kind.shape, dtype=bool)
    displacement = np.empty(len(log))
    reach = number(parameters["motion_range"]) * widths
    run(log.offset_m, kind, log.lri, follows, reach, is_held, displacement)
    kind = np.where(is_held, -1, kind)
    offset = np.where(kind >= 0, log.offset_m, 0.0)
    return SeenLines(offset, kind, motion_index(displacement / widths, steps, parameters))


def line_classes(log: LineLog) -> IntArray:
    """(T, L): the class of each line, -1 where there is none or it is out of reach. A line of
    unknown LRI counts as reliable."""
    reliable = np.isnan(log.lri) | (log.lri >= STRONG_LRI)
    tracked = log.lri >= LEAST_LRI
    kind = np.where(log.is_valid, np.where(reliable, 1, 2), np.where(tracked, 3, -1))
    kind[log.is_valid & log.is_continuous] = 0
    with np.errstate(invalid="ignore"):
        distance = np.abs(log.offset_m)
        kind[~((distance > 1e-6) & (distance < REACH_M))] = -1
    return kind.astype(np.int64)
