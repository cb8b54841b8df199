"""What the line geometry takes from a log: which lines count, how they moved, lane widths."""

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

#: Lanes in metres are not narrower or wider, even in those of a detector that is wrong by half.
NARROWEST_M, WIDEST_M = 1.5, 6.0

#: Two lines nearer than this, lane widths, are one border between lanes: a double line, the edges
#: of one marking, a line reported twice. Looked for where one line in so many is such.
DOUBLE, LEAST_DOUBLES = 0.1, 0.1

#: The vehicle is said to be off centre from so many lane widths on (drivers of the paper's drives
#: keep .05 to .14 to the left), where lines do not lie just anywhere and there are enough.
OFF_CENTRE, STEADY, ENOUGH_LINES = 0.2, 0.3, 1000

#: Seconds between frames for which alpha and beta are meant: the paper's recordings have ten frames
#: a second.
FRAME_S = 0.1

#: With `lane_width_m: causal`, the width and the detector's habits are told anew from all frames so
#: far, each time that so many have passed.
LOOK_AGAIN = 200


@dataclass(frozen=True)
class SeenLines:
    """A log's lines, read for the geometry.

    offset_m (T, L): 0 where there is no line. kind (T, L): the class of a line that counts, else
    -1. motion (T,): the value of LineMotion. is_double (T, L): a line that counts beside a better
    one, on the same border between lanes.
    """

    offset_m: FloatArray
    kind: IntArray
    motion: IntArray
    is_double: BoolArray

    @property
    def lines(self) -> IntArray:
        """(T, 2): how many lines of each frame count, and how many of them are doubles."""
        return np.stack([(self.kind >= 0).sum(axis=1), self.is_double.sum(axis=1)], axis=1)


def recording_width(log: LineLog, parameters: Parameters) -> float:
    """The lane width of a whole recording, given or found; what was found is said in a warning."""
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
    """The log and the lane widths (T,) of its frames; where no lane in metres is so narrow or so
    wide, both brought to the expected width, since the model's noise, clutter and reach are in
    metres."""
    expected = number(parameters, "fallback_width_m")
    is_other = (widths < NARROWEST_M) | (widths > WIDEST_M)
    if not is_other.any():
        return log, widths
    scale = np.where(is_other, expected / widths, 1.0)
    offset = log.offset_m * scale[:, None]
    return replace(log, offset_m=offset), np.where(is_other, expected, widths)


def say_places(log: LineLog, widths: FloatArray) -> None:
    """Warn where the lines lie oddly: out of reach, or so that the vehicle seems to keep beside the
    middle of its lanes all the time. log, widths (T,): in metres."""
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
    # Where each line lies between the places it has from the middle of a lane, as an angle.
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
    """The lane width that a recording is learned from with: the given one, else that of all its
    lines. Says nothing."""
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
    """Which lines count, and how they moved. widths (T,): lane width of each frame, metres.
    repeats_are_held: see `_line_detector.Habits`."""
    kind = line_classes(log)
    steps = np.ones(len(log), dtype=np.int64)
    steps[1:] = np.diff(log.frame_id)
    # A frame that was put in says nothing about motion, nor does the one after it.
    follows = (steps == 1) & ~log.is_missing
    follows[1:] &= ~log.is_missing[:-1]
    is_held = np.zeros(kind.shape, dtype=bool)
    displacement = np.empty(len(log))
    reach = number(parameters, "motion_range") * widths
    lri = log.lri
    if repeats_are_held:
        # One that falls with every frame.
        lri = np.repeat(-np.arange(float(len(log)))[:, None], lri.shape[1], axis=1)
    kernels.follow_lines(log.offset_m, kind, lri, follows, reach, is_held, displacement)
    kind = np.where(is_held, -1, kind)
    single = kind.copy()
    kernels.drop_doubles(log.offset_m, single, DOUBLE * widths)
    offset = np.where(kind >= 0, log.offset_m, 0.0)
    motion = motion_index(displacement / widths, steps, parameters)
    return SeenLines(offset, kind, motion, kind != single)


def count_once(seen: SeenLines, lines: IntArray) -> SeenLines:
    """Leaves the doubles out where the detector reports many. lines: numbers of lines and of
    doubles by which it is judged, (2,) for all frames or (T, 2) for each."""
    has_many = lines[..., 1] >= LEAST_DOUBLES * lines[..., 0]
    return replace(seen, kind=np.where(seen.is_double & has_many[..., None], -1, seen.kind))


def say_doubles(lines: IntArray, source: str) -> None:
    """Warn where `count_once` leaves lines out."""
    if lines[1] and lines[1] >= LEAST_DOUBLES * lines[0]:
        warnings.warn(
            f"{source}: {100 * lines[1] / lines[0]:.0f} % of the lines lie within {DOUBLE:g} lane"
            " widths of another one; such lines count once",
            UserWarning,
            stacklevel=2,
        )


def frame_weights(log: LineLog, last_s: float = -math.inf) -> tuple[FloatArray, float]:
    """(T,): how many frames' worth of evidence each frame is, the time since the one before over
    `FRAME_S`; and the time of the last one. Errors of a detector last for seconds, not for frames:
    what lines say in a second weighs the same however many frames there are in it. last_s: the time
    of the frame before the first, if any; frames that were put in do not count."""
    real_s = np.maximum.accumulate([last_s, *np.where(log.is_missing, -np.inf, log.time_s)])
    with np.errstate(invalid="ignore"):
        passed = log.time_s - real_s[:-1]
        is_known = np.isfinite(passed) & (passed > 0)
        # Rounded: times are quotients, ten frames a second are to weigh 1 exactly.
        return np.where(is_known, np.round(passed / FRAME_S, 6), 1.0), float(real_s[-1])


def line_classes(log: LineLog) -> IntArray:
    """(T, L): the class of each line, -1 where there is none or it is out of reach. Unknown LRI:
    a valid line counts as reliable, another as tracked."""
    unknown = np.isnan(log.lri)
    reliable = unknown | (log.lri >= STRONG_LRI)
    tracked = unknown | (log.lri >= LEAST_LRI)
    kind = np.where(log.is_valid, np.where(reliable, 1, 2), np.where(tracked, 3, -1))
    kind[log.is_valid & log.is_continuous] = 0
    with np.errstate(invalid="ignore"):
        is_near = np.abs(log.offset_m) < REACH_M
    kind[~(is_placed(log) & is_near)] = -1
    return kind.astype(np.int64)
