"""Read a log for the line geometry: which lines count, how they moved, and the lane width."""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry import flag_semantics, kernels
from egolane_pgm.evidence.line_geometry.kernels import DOUBLE, LastFrame
from egolane_pgm.evidence.line_geometry.lane_width import gap_counts, width_of_gaps
from egolane_pgm.evidence.line_geometry.model import LANE_M, REACH_M
from egolane_pgm.evidence.line_geometry.scale import line_classes
from egolane_pgm.graphs.position_in_lane import KEPT_VELOCITY, MOTION_RANGE
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import NOTE, FloatArray, IntArray, LineLog

#: The narrowest and the widest lane in metres, even of a detector whose scale is wrong by half.
NARROWEST_M = 1.5
WIDEST_M = 6.0

#: Double lines count once if at least this share of the lines are such doubles.
LEAST_DOUBLES = 0.1

#: The mean offset of a vehicle from the middle of its lane, lane widths, from which a warning is
#: given. Drivers of the paper's drives keep .05 to .14 to the left.
OFF_CENTRE = 0.2

#: The least agreement of the lines' places for this warning, 0 (uniform) to 1 (equal).
STEADY = 0.3

#: The least number of lines for this warning.
ENOUGH_LINES = 1000

#: The relative difference between the lane widths of the halves of a recording from which a warning
#: is given. With SURE_OF_HALF it was never wrong in 500 stretches of the paper's recordings, half a
#: minute to ten minutes long.
ANOTHER_SCALE = 0.1

#: The least log odds (natural) of the width of each half for this warning.
SURE_OF_HALF = 20.0

#: With `lane_width_m: causal`, the number of frames after which the detector's conventions are
#: estimated again, from all frames so far.
UPDATE_EVERY = 200


class SeenLines(NamedTuple):
    """The lines of a log, read for the geometry.

    - offset_m: (T, L) in the detector's unit
    - kind: (T, L) the class of a line that counts, otherwise -1
    - weights: (T,) the weight of a frame's evidence, ticks
    - displacement: (T,) of the lines since the last tick, lane widths; NaN if unknown
    - ticks: (T,) that begin with the frame
    - velocity: (T,) of the lines before the frame, lane widths per tick
    """

    offset_m: FloatArray
    kind: IntArray
    weights: FloatArray
    displacement: FloatArray
    ticks: IntArray
    velocity: FloatArray


def read_recording(recorded: LineLog, parameters: Parameters) -> tuple[LineLog, SeenLines, float]:
    """Return a whole recording on the paper's scale, its lines, and its lane width.

    Warns of the lane width found and of anything unusual about the lines.
    """
    detector = flag_semantics.flag_semantics_of(
        flag_semantics.count_lines([flag_semantics.columns(recorded)]), recorded.source
    )
    for note in detector.notes:
        warnings.warn(note, stacklevel=2)
    log = flag_semantics.translated(recorded, detector)
    width = recording_width(log, parameters)
    warn_of_offsets(log, width)
    kind, _ = line_classes(log.offset_m, log.is_valid, log.is_continuous, log.lri)
    widths = np.full(len(log), width)
    seen, _ = read_lines(log, kind, widths, detector.repeats_are_held)
    return log, seen, width


def recording_width(log: LineLog, parameters: Parameters) -> float:
    """Return the lane width of a whole recording, given or estimated.

    Warns of an estimate, and of halves with different widths.
    """
    given = parameters["lane_width_m"]
    fallback = number(parameters, "fallback_width_m")
    middle = len(log) // 2
    halves = [gap_counts(log.take(part)) for part in (slice(0, middle), slice(middle, None))]
    if not isinstance(given, str):
        width_m = number(parameters, "lane_width_m")
    else:
        whole = width_of_gaps(halves[0] + halves[1], fallback, log.source)
        message = whole.message
        width_m = whole.width_m
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
            f"{log.source}: lane width {first.width_m:.3g} m in the first half of the"
            f" recording, {second.width_m:.3g} m in the second: does its unit change?",
            stacklevel=2,
        )
    return width_m


def warn_of_offsets(log: LineLog, width_m: float) -> None:
    """Warn if most lines are out of reach, or if the vehicle seems to be off the middle of its
    lane all the time."""
    reach_m = width_m * REACH_M / LANE_M
    placed = flag_semantics.is_placed(log.offset_m)
    n_placed = int(placed.sum())
    n_far = int((np.abs(log.offset_m[placed]) >= reach_m).sum())
    if 2 * n_far > n_placed:
        warnings.warn(
            f"{log.source}: {n_far} of {n_placed} lines are {reach_m:.4g} m away or more and are"
            f" not used, with lanes of {width_m:.4g} m; are offsets in metres from the vehicle?",
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
            stacklevel=2,
        )


#: Before the first frame.
NO_FRAME = LastFrame(
    *(np.empty(0), np.empty(0), False, 0, -math.inf),
    *(np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=bool), 0.0),
    *(0.0, np.zeros(2, dtype=np.int64)),
)


def read_lines(
    log: LineLog,
    kind: IntArray,
    widths: FloatArray,
    repeats_are_held: bool,
    last: LastFrame | None = None,
) -> tuple[SeenLines, LastFrame]:
    """Find which lines count and how they moved; also return the last frame, for the next log.

    If a detector reports many double lines, they count once. Warns of it for a whole recording.

    - kind: (T, L) the class of each line; set to -1 for lines out of reach
    - widths: (T,) lane width before each frame
    - repeats_are_held: as in `flag_semantics.FlagSemantics`
    - last: the frame before the first; None for a whole recording, in which the share of doubles
      is that among all lines instead of those so far
    """
    is_whole = last is None
    last = last or NO_FRAME
    # A log may have integers.
    offset_m = np.asarray(log.offset_m, dtype=np.float64)
    lri = np.asarray(log.lri, dtype=np.float64)
    ticks, weights, is_after_gap, passed = kernels.count_ticks(log.frame_id, log.time_s, last)
    is_held, displacement, begin = kernels.follow_lines(
        offset_m,
        kind,
        lri,
        log.is_missing,
        ticks,
        is_after_gap,
        repeats_are_held,
        widths,
        REACH_M / LANE_M,
        MOTION_RANGE,
        last,
    )
    velocity = kernels.coast(displacement, ticks, MOTION_RANGE, KEPT_VELOCITY, last.velocity)
    measured = np.where(is_held, -1, kind)
    is_double, lines = kernels.find_doubles(offset_m, measured, widths, last.lines)
    if len(log):
        if begin >= 0:
            shown = slice(0, 0 if log.is_missing[begin] else None)
            last = last._replace(
                before_m=offset_m[begin, shown].copy(),
                before_kind=kind[begin, shown],
                before_held=is_held[begin, shown],
            )
        # Copies: a caller may use its arrays again for the next frame.
        last = last._replace(
            offset_m=offset_m[-1].copy(),
            lri=lri[-1].copy(),
            is_real=not log.is_missing[-1],
            frame_id=int(log.frame_id[-1]),
            time_s=float(log.time_s[-1]),
            passed=passed,
            velocity=velocity[-1],
            lines=lines[-1],
        )
    if is_double.any():
        total, doubles = lines[-1:].T if is_whole else lines[1:].T
        has_many = doubles >= LEAST_DOUBLES * total
        measured[is_double & has_many[:, None]] = -1
        if is_whole and has_many[0]:
            warnings.warn(
                f"{log.source}: {100 * doubles[0] / total[0]:.0f} % of the lines lie within"
                f" {DOUBLE:g} lane widths of another one; such lines count once",
                stacklevel=2,
            )
    return SeenLines(offset_m, measured, weights, displacement, ticks, velocity[:-1]), last
