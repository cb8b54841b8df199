"""Read a log for the line geometry: which lines count, how they moved, and the lane width."""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.flag_semantics import is_placed
from egolane_pgm.evidence.line_geometry.lane_width import (
    gap_counts,
    lane_width,
    rounded,
    width_of_gaps,
)
from egolane_pgm.evidence.line_geometry.model import LANE_M, REACH_M
from egolane_pgm.graphs.position_in_lane import KEPT_VELOCITY, MOTION_RANGE, motion_index
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import NOTE, BoolArray, FloatArray, IntArray, LineLog

#: The narrowest and the widest lane in metres, even of a detector whose scale is wrong by half.
NARROWEST_M, WIDEST_M = 1.5, 6.0

#: Two lines nearer than the first, in lane widths, are one border between lanes: a double line, the
#: edges of one marking, or a line reported twice. They count once if at least the second share of
#: the lines are such doubles.
DOUBLE, LEAST_DOUBLES = 0.1, 0.1

#: Warn of a vehicle off centre from the first on, in lane widths (drivers of the
#: paper's drives keep .05 to .14 to the left), if the lines' places agree at least as well as the
#: second (0 to 1) and there are enough lines.
OFF_CENTRE, STEADY, ENOUGH_LINES = 0.2, 0.3, 1000

#: Warn of halves of a recording with different lane widths if these differ by more
#: than this share and each has at least these log odds (natural). It was never wrong in 500
#: stretches of the paper's recordings, half a minute to ten minutes long.
ANOTHER_SCALE, SURE_OF_HALF = 0.1, 20.0

#: The time between frames of alpha and beta, seconds: the paper's recordings have
#: ten frames per second.
FRAME_S = 0.1

#: The number of frames, about, over which the mean displacement of the lines is their velocity.
INERTIA = 10.0

#: With `lane_width_m: causal`, the number of frames after which the detector's conventions are
#: estimated again, from all frames so far.
UPDATE_EVERY = 200


class SeenLines(NamedTuple):
    """The lines of a log, read for the geometry.

    - offset_m: (T, L) in the detector's unit
    - kind: (T, L) the class of a line that counts, otherwise -1
    - motion: (T,) the value of LineMotion
    - is_double: (T, L) whether a better line on the same border between lanes counts as well
    - lines: (T, 2) the numbers of lines up to each frame that count, and of doubles among them
    """

    offset_m: FloatArray
    kind: IntArray
    motion: IntArray
    is_double: BoolArray
    lines: IntArray


def recording_width(log: LineLog, parameters: Parameters) -> float:
    """Return the lane width of a whole recording, given or estimated.

    Warns of an estimate, and of halves with different widths.
    """
    given, fallback = parameters["lane_width_m"], number(parameters, "fallback_width_m")
    middle = len(log) // 2
    halves = [gap_counts(log.take(part)) for part in (slice(0, middle), slice(middle, None))]
    if not isinstance(given, str):
        width_m = number(parameters, "lane_width_m")
    else:
        whole = width_of_gaps(halves[0] + halves[1], fallback, log.source)
        message, width_m = whole.message, whole.width_m
        if whole.is_sure:
            if NARROWEST_M <= width_m <= WIDEST_M:
                message = NOTE + message
            else:
                message += "; no lane has that in metres, offsets are taken to be in another unit"
        warnings.warn(message, UserWarning, stacklevel=2)
    first, second = (width_of_gaps(gaps, fallback, log.source) for gaps in halves)
    change = abs(math.log(second.width_m / first.width_m))
    is_sure = first.is_sure and second.is_sure and min(first.odds, second.odds) >= SURE_OF_HALF
    if is_sure and change > math.log1p(ANOTHER_SCALE):
        warnings.warn(
            f"{log.source}: lane width {rounded(first.width_m):g} m in the first half of the"
            f" recording, {rounded(second.width_m):g} m in the second: does its unit change?",
            UserWarning,
            stacklevel=2,
        )
    return width_m


def warn_of_offsets(log: LineLog, width_m: float, reach_m: float) -> None:
    """Warns if most lines are out of reach, or if the vehicle seems to be off the middle of its
    lane all the time."""
    placed = is_placed(log.offset_m)
    n_placed, n_far = int(placed.sum()), int((np.abs(log.offset_m[placed]) >= reach_m).sum())
    if 2 * n_far > n_placed:
        warnings.warn(
            f"{log.source}: {n_far} of {n_placed} lines are {reach_m:.4g} m away or more and are"
            f" not used, with lanes of {width_m:.4g} m; are offsets in metres from the vehicle?",
            UserWarning,
            stacklevel=2,
        )
    near = log.is_valid & placed & (np.abs(log.offset_m) < 1.5 * width_m)
    # A line's place modulo the lane width, as an angle: 0 for a car in the middle of its lane.
    angle = 2 * math.pi * (log.offset_m / width_m - 0.5)[near]
    if len(angle) < ENOUGH_LINES:
        return
    mean = np.exp(1j * angle).mean()
    off = float(np.angle(mean)) / (2 * math.pi)
    if abs(off) >= OFF_CENTRE and abs(mean) >= STEADY:
        warnings.warn(
            f"{log.source}: the lines lie {abs(off) * width_m:.1f} m"
            f" {'right' if off > 0 else 'left'} of where a vehicle in the middle of its lane has"
            " them, on average: is offset 0 the vehicle's middle? Otherwise lane changes are"
            " reported early or late",
            UserWarning,
            stacklevel=2,
        )


def one_width(log: LineLog, parameters: Parameters) -> float:
    """Return the given or estimated lane width of a recording, without a warning."""
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        return number(parameters, "lane_width_m")
    return lane_width(log, number(parameters, "fallback_width_m")).width_m


def as_metres(width_m: float, parameters: Parameters) -> float:
    """The lane width, or the expected one if no lane has that in metres."""
    is_metres = NARROWEST_M <= width_m <= WIDEST_M
    return width_m if is_metres else number(parameters, "fallback_width_m")


class LastFrame(NamedTuple):
    """The lines of a frame, kept to read the next one.

    - offset_m, kind, lri, is_held: (L,) its lines
    - frame_id, state: its frame id, and 1, or 0 if it fills a gap, or -1 if there was none
    - velocity: of the lines, lane widths per frame
    - lines: (2,) the numbers of lines up to it that count, and of doubles among them
    """

    offset_m: FloatArray
    kind: IntArray
    lri: FloatArray
    is_held: BoolArray
    frame_id: int
    state: int
    velocity: float
    lines: IntArray


#: Before the first frame.
NO_FRAME = LastFrame(
    *(np.empty(0), np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=bool)),
    *(0, -1, 0.0, np.zeros(2, dtype=np.int64)),
)


def read_lines(
    log: LineLog,
    kind: IntArray,
    widths: FloatArray,
    parameters: Parameters,
    *,
    repeats_are_held: bool = False,
    last: LastFrame = NO_FRAME,
) -> tuple[SeenLines, LastFrame]:
    """Finds which lines count and how they moved; also gives the `Last` lines for the next frame.

    - kind: (T, L) the class of each line; set to -1 for lines out of reach
    - widths: (T,) lane width before each frame
    - repeats_are_held: as in `flag_semantics.FlagSemantics`
    - last: of the frame before the first
    """
    n_frames = len(log)
    # A log may have integers.
    offset_m = np.asarray(log.offset_m, dtype=np.float64)
    lri = np.asarray(log.lri, dtype=np.float64)
    is_held, is_double = np.empty(kind.shape, dtype=bool), np.empty(kind.shape, dtype=bool)
    displacement, steps = np.empty(n_frames), np.empty(n_frames, dtype=np.int64)
    kernels.follow_lines(
        offset_m,
        kind,
        lri,
        log.frame_id,
        log.is_missing,
        repeats_are_held,
        widths,
        REACH_M / LANE_M,
        MOTION_RANGE,
        *last[:6],
        is_held,
        displacement,
        steps,
    )
    velocity, lines = np.empty(n_frames + 1), np.empty((n_frames + 1, 2), dtype=np.int64)
    velocity[0], lines[0] = last.velocity, last.lines
    kernels.coast(displacement, steps, MOTION_RANGE, INERTIA, KEPT_VELOCITY, velocity)
    motion = motion_index(displacement, steps, velocity[:-1], parameters)
    measured = np.where(is_held, -1, kind)
    kernels.find_doubles(offset_m, measured, widths, DOUBLE, is_double, lines)
    if n_frames:
        # Copies: a caller may use its arrays again for the next frame.
        of_lines = (offset_m[-1].copy(), kind[-1], lri[-1].copy(), is_held[-1])
        frame = (int(log.frame_id[-1]), 0 if log.is_missing[-1] else 1)
        last = LastFrame(*of_lines, *frame, velocity[-1], lines[-1])
    return SeenLines(offset_m, measured, motion, is_double, lines[1:]), last


def count_once(seen: SeenLines, lines: IntArray) -> SeenLines:
    """Leaves out the doubles if the detector reports many.

    lines: numbers of lines and of doubles that decide it, (2,) for all frames or (T, 2) for each.
    """
    if not seen.is_double.any():
        return seen
    has_many = lines[..., 1] >= LEAST_DOUBLES * lines[..., 0]
    return seen._replace(kind=np.where(seen.is_double & has_many[..., None], -1, seen.kind))


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
    for any frame rate. Frames that fill gaps do not count.

    last_s: the time of the frame before the first, if there is one, seconds.
    """
    weights = np.empty(len(log))
    return weights, kernels.weigh_frames(log.time_s, log.is_missing, FRAME_S, last_s, weights)
