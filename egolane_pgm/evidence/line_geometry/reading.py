"""Reads a log for the line geometry: which lines count, how they moved, and the lane width."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.habits import is_placed
from egolane_pgm.evidence.line_geometry.lane_width import lane_width, rounded
from egolane_pgm.evidence.line_geometry.model import LEAST_LRI, REACH_M, STRONG_LRI
from egolane_pgm.graphs.position_in_lane import motion_index
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: The narrowest and the widest lane in metres, even of a detector whose scale is wrong by half.
NARROWEST_M, WIDEST_M = 1.5, 6.0

#: Two lines nearer than the first, in lane widths, are one border between lanes: a double line, the
#: edges of one marking, or a line reported twice. They count once if at least the second share of
#: the lines are such doubles.
DOUBLE, LEAST_DOUBLES = 0.1, 0.1

#: A warning says that the vehicle is off centre from the first on, in lane widths (drivers of the
#: paper's drives keep .05 to .14 to the left), if the lines' places agree at least as well as the
#: second (0 to 1) and there are enough lines.
OFF_CENTRE, STEADY, ENOUGH_LINES = 0.2, 0.3, 1000

#: The time between frames for which alpha and beta are meant, seconds: the paper's recordings have
#: ten frames per second.
FRAME_S = 0.1

#: With `lane_width_m: causal`, the lane width and the detector's habits are estimated anew, from
#: all frames so far, after every so many frames.
UPDATE_EVERY = 200


@dataclass(frozen=True)
class SeenLines:
    """The lines of a log, read for the geometry.

    - offset_m: (T, L) metres; 0 where there is no line
    - kind: (T, L) the class of a line that counts, otherwise -1
    - motion: (T,) the value of LineMotion
    - is_double: (T, L) whether a better line on the same border between lanes counts as well
    """

    offset_m: FloatArray
    kind: IntArray
    motion: IntArray
    is_double: BoolArray

    @property
    def lines(self) -> IntArray:
        """How many lines of each frame count, and how many of them are doubles, (T, 2)."""
        return np.stack([(self.kind >= 0).sum(axis=1), self.is_double.sum(axis=1)], axis=1)


def recording_width(log: LineLog, parameters: Parameters) -> float:
    """The lane width of a whole recording, given or found; a warning says which one was found."""
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        return number(parameters, "lane_width_m")
    fallback = number(parameters, "fallback_width_m")
    whole = lane_width(log, fallback)
    message = whole.message
    if whole.is_sure and not NARROWEST_M <= whole.width_m <= WIDEST_M:
        message += (
            f"; no lane has that in metres, offsets are scaled to lanes of {rounded(fallback):g} m"
        )
    warnings.warn(message, UserWarning, stacklevel=2)
    return whole.width_m


def in_metres(
    log: LineLog, widths: FloatArray, parameters: Parameters
) -> tuple[LineLog, FloatArray]:
    """Scales the log and its lane widths (T,) to metres, as the model's noise, clutter and reach
    are in metres. Only frames with a width that no lane in metres has are scaled, to the expected
    width."""
    expected = number(parameters, "fallback_width_m")
    is_other = (widths < NARROWEST_M) | (widths > WIDEST_M)
    if not is_other.any():
        return log, widths
    scale = np.where(is_other, expected / widths, 1.0)
    offset = log.offset_m * scale[:, None]
    return replace(log, offset_m=offset), np.where(is_other, expected, widths)


def warn_of_offsets(log: LineLog, widths: FloatArray) -> None:
    """Warns if most lines are out of reach, or if the vehicle seems to be off the middle of its
    lane all the time. log and widths (T,) are in metres."""
    placed = is_placed(log)
    n_placed, n_far = int(placed.sum()), int((np.abs(log.offset_m[placed]) >= REACH_M).sum())
    if 2 * n_far > n_placed:
        warnings.warn(
            f"{log.source}: {n_far} of {n_placed} lines are {REACH_M:g} m away or more and are not"
            " used; are offsets in metres from the vehicle?",
            UserWarning,
            stacklevel=2,
        )
    near = log.is_valid & placed & (np.abs(log.offset_m) < 1.5 * widths[:, None])
    # A line's place modulo the lane width, as an angle: 0 for a car in the middle of its lane.
    angle = 2 * math.pi * (log.offset_m / widths[:, None] - 0.5)[near]
    if len(angle) < ENOUGH_LINES:
        return
    mean = np.exp(1j * angle).mean()
    off = float(np.angle(mean)) / (2 * math.pi)
    if abs(off) >= OFF_CENTRE and abs(mean) >= STEADY:
        warnings.warn(
            f"{log.source}: the lines lie {abs(off) * float(np.median(widths)):.1f} m"
            f" {'right' if off > 0 else 'left'} of where a vehicle in the middle of its lane has"
            " them, on average: is offset 0 the vehicle's middle? Lane changes are told early or"
            " late otherwise",
            UserWarning,
            stacklevel=2,
        )


def one_width(log: LineLog, parameters: Parameters) -> float:
    """The lane width with which a recording is learned from: the given one, or the one found. There
    is no warning."""
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        return number(parameters, "lane_width_m")
    return lane_width(log, number(parameters, "fallback_width_m")).width_m


def read_lines(
    log: LineLog,
    widths: FloatArray,
    parameters: Parameters,
    *,
    repeats_are_held: bool = False,
) -> SeenLines:
    """Finds which lines count and how they moved.

    - widths: (T,) lane width of each frame, metres
    - repeats_are_held: as in `habits.Habits`
    """
    kind = line_classes(log)
    steps = np.ones(len(log), dtype=np.int64)
    steps[1:] = np.diff(log.frame_id)
    # Neither a frame that fills a gap nor the one after it shows motion.
    follows = (steps == 1) & ~log.is_missing
    follows[1:] &= ~log.is_missing[:-1]
    is_held = np.zeros(kind.shape, dtype=bool)
    displacement = np.empty(len(log))
    reach = number(parameters, "motion_range") * widths
    lri = log.lri
    if repeats_are_held:
        # An LRI that falls with every frame makes every repeated offset a held line.
        lri = np.repeat(-np.arange(float(len(log)))[:, None], lri.shape[1], axis=1)
    kernels.follow_lines(log.offset_m, kind, lri, follows, reach, is_held, displacement)
    kind = np.where(is_held, -1, kind)
    single = kind.copy()
    kernels.drop_doubles(log.offset_m, single, DOUBLE * widths)
    offset = np.where(kind >= 0, log.offset_m, 0.0)
    motion = motion_index(displacement / widths, steps, parameters)
    return SeenLines(offset, kind, motion, kind != single)


def count_once(seen: SeenLines, lines: IntArray) -> SeenLines:
    """Leaves out the doubles if the detector reports many.

    lines: numbers of lines and of doubles that decide it, (2,) for all frames or (T, 2) for each.
    """
    has_many = lines[..., 1] >= LEAST_DOUBLES * lines[..., 0]
    return replace(seen, kind=np.where(seen.is_double & has_many[..., None], -1, seen.kind))


def warn_of_doubles(lines: IntArray, source: str) -> None:
    """Warns if `count_once` leaves lines out."""
    if lines[1] and lines[1] >= LEAST_DOUBLES * lines[0]:
        warnings.warn(
            f"{source}: {100 * lines[1] / lines[0]:.0f} % of the lines lie within {DOUBLE:g} lane"
            " widths of another one; such lines count once",
            UserWarning,
            stacklevel=2,
        )


def frame_weights(log: LineLog, last_s: float = -math.inf) -> tuple[FloatArray, float]:
    """The weight of each frame's evidence, (T,): the time since the frame before over `FRAME_S`.
    Also gives the time of the last frame.

    The errors of a detector last for seconds, not for frames, so a second of lines weighs the same
    whatever the frame rate. Frames that fill gaps do not count.

    last_s: the time of the frame before the first, if there is one, seconds.
    """
    real_s = np.maximum.accumulate([last_s, *np.where(log.is_missing, -np.inf, log.time_s)])
    with np.errstate(invalid="ignore"):
        passed = log.time_s - real_s[:-1]
        is_known = np.isfinite(passed) & (passed > 0)
        # Times are quotients; after rounding, ten frames per second weigh exactly 1.
        return np.where(is_known, np.round(passed / FRAME_S, 6), 1.0), float(real_s[-1])


def line_classes(log: LineLog) -> IntArray:
    """The class of each line, (T, L); -1 where there is none or it is out of reach. With an unknown
    LRI, a valid line counts as reliable and any other as tracked."""
    unknown = np.isnan(log.lri)
    reliable = unknown | (log.lri >= STRONG_LRI)
    tracked = unknown | (log.lri >= LEAST_LRI)
    kind = np.where(log.is_valid, np.where(reliable, 1, 2), np.where(tracked, 3, -1))
    kind[log.is_valid & log.is_continuous] = 0
    with np.errstate(invalid="ignore"):
        is_near = np.abs(log.offset_m) < REACH_M
    kind[~(is_placed(log) & is_near)] = -1
    return kind.astype(np.int64)
