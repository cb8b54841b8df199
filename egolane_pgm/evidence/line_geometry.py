"""Lines as what they are: measurements of where the road's lines lie. Evidence about the place on
the road (`graphs.position_in_lane`) instead of votes for lanes.

Each lane predicts where lines are seen and how often (`_line_model`). With p_l(u) the likelihood of
a frame's lines at u in lane l and pbar(u) that of their mean intensity over the lanes, the joint
likelihood of RoadPosition and SensorState is

    OK:  pbar(u)^beta (p_l(u) / pbar(u))^alpha        BAD:  pbar(u)^beta

alpha and beta are small because the errors of neighbouring frames are much alike: the filter would
count each of them as news. A working sensor tells lane and place inside it, a failing one only the
place.

A line that the detector could not measure and holds where it was (offset the same to the last
digit, LRI falling) says nothing new: it is no evidence, and not followed. Offsets of exactly 0 are
placeholders. LineMotion is the median displacement of the lines that were measured in this frame
and the one before, matched to the nearest.

A detector that never says that a line is continuous is taken for one that cannot tell.

No label is needed: where `rates` and the like are `generic`, they are the same for every detector,
and the lane width is estimated from the gaps between lines.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from egolane_pgm.evidence._lane_width import LaneWidth, gap_counts, lane_width, width_of_gaps
from egolane_pgm.evidence._line_em import fit_lines
from egolane_pgm.evidence._line_model import (
    FITTED,
    LEAST_LRI,
    N_CLASSES,
    REACH_M,
    STRONG_LRI,
    TABLE_STEP_M,
    LineModel,
    LineTables,
    line_model,
    line_tables,
    without_flags,
)
from egolane_pgm.graphs._parameters import number
from egolane_pgm.graphs.position_in_lane import CELLS, MOTION_BINS, MOTION_RANGE, motion_index
from egolane_pgm.types import (
    BoolArray,
    Evidence,
    FloatArray,
    IntArray,
    LineLog,
    Parameter,
    Parameters,
    Value,
)

NODES = ("RoadPosition", "SensorState")
PROVIDES = (NODES,)

#: What `fit` learns.
LEARNED = (*FITTED, "fallback_width_m")

#: With `lane_width_m: causal`, frames until the width is looked at again.
LOOK_AGAIN = 200

_OR_FITTED = "; `generic`, or a list that `egolane learn` writes"

PARAMETERS = (
    Parameter(
        "lane_width_m",
        "positive",
        "auto",
        "lane width in the detector's metres: a number, `auto` (from the lines of the whole"
        " recording) or `causal` (from those of the frames so far)",
        choices=("auto", "causal"),
    ),
    Parameter(
        "fallback_width_m", "positive", 3.5, "lane width where the lines do not tell it, metres"
    ),
    Parameter(
        "alpha", "non_negative", 0.05, "weight of what lines say of the lane", search=(0.01, 0.2)
    ),
    Parameter(
        "beta",
        "non_negative",
        0.15,
        "weight of what lines say of the place inside the lane",
        search=(0.05, 1.0),
    ),
    Parameter(
        "rates",
        "non_negative",
        "generic",
        "expected lines from each lane: a row of n + 3 per lane, the n + 1 lines of the road, then"
        " left and right shoulder" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n, n + 3),
    ),
    Parameter(
        "class_shares",
        "probability",
        "generic",
        "shares of the line classes: a row of four per line" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n + 3, N_CLASSES),
    ),
    Parameter(
        "sigmas_m",
        "sigma",
        "generic",
        "standard deviation of each line about its place, metres" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n + 3,),
    ),
    Parameter(
        "shoulders",
        "positive",
        "generic",
        "distance of the left and right shoulder line from the road, lane widths" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (2,),
    ),
    Parameter(
        "clutter",
        "non_negative",
        "generic",
        "lines that are none, per metre, of each class" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (N_CLASSES,),
    ),
    Parameter("seen_near", "non_negative", 0.9, "generic rate of the lines of the own lane"),
    Parameter("fade", "non_negative", 0.2, "share of it that each lane further away takes off"),
    Parameter("seen_far", "non_negative", 0.15, "lowest generic rate of a line of the road"),
    Parameter("shoulder_left", "non_negative", 0.08, "generic rate of a line left of the road"),
    Parameter("shoulder_right", "non_negative", 0.13, "generic rate of a line right of the road"),
    Parameter("shoulder_distance", "positive", 0.9, "generic distance of those, lane widths"),
    Parameter(
        "edge_continuous",
        "probability",
        0.25,
        "generic share of continuous among what is seen of the road's outer lines",
    ),
    Parameter("inner_continuous", "probability", 0.05, "the same of all other lines"),
    Parameter("line_sigma_m", "sigma", 0.25, "generic standard deviation of a line, metres"),
    Parameter("clutter_per_m", "non_negative", 0.05, "generic clutter, lines per metre"),
    CELLS,
    MOTION_BINS,
    MOTION_RANGE,
)


@dataclass(frozen=True)
class SeenLines:
    """A log's lines, read for the geometry.

    offset_m (T, L): 0 where there is no line. kind (T, L): the class of a line that counts, else
    -1. motion (T,): the value of LineMotion.
    """

    offset_m: FloatArray
    kind: IntArray
    motion: IntArray


def evidence(
    log: LineLog, n_lanes: int, parameters: Parameters, *, kernel: bool = True
) -> Evidence:
    """(RoadPosition, SensorState) (T, n cells, 2), each frame's largest 1, and the input
    LineMotion (T,).

    parameters: resolved values of PARAMETERS. `kernel=False` runs the NumPy twins. What lane width
    was found is said in a warning.
    """
    widths = frame_widths(log, parameters)
    seen = read_lines(log, widths, parameters, kernel=kernel)
    model = line_model(n_lanes, parameters)
    if not log.is_continuous.any():
        model = without_flags(model)
    likelihood = _likelihood(seen, widths, model, parameters, kernel, {})
    return Evidence({NODES: likelihood}, {"LineMotion": seen.motion})


def online(
    n_lanes: int, parameters: Parameters, *, kernel: bool = True
) -> Callable[[LineLog], Evidence]:
    """A function that gives the evidence of one frame after the other (or of some at a time), each
    log following on the one before. A width from the lines is `causal`, and the detector can tell
    continuous lines from the first one on; what was found is not said."""
    flagged = line_model(n_lanes, parameters)
    model = without_flags(flagged)
    known: dict[float, LineTables] = {}
    given = parameters["lane_width_m"]
    fallback = number(parameters["fallback_width_m"])
    width = fallback if isinstance(given, str) else number(given)
    context: LineLog | None = None
    n_frames = 0
    total = np.zeros(0)

    def give(log: LineLog) -> Evidence:
        nonlocal context, width, n_frames, total, model
        if model is not flagged and log.is_continuous.any():
            model = flagged
            known.clear()
        widths = np.empty(len(log))
        for t in range(len(log)):
            if isinstance(given, str):
                if n_frames and n_frames % LOOK_AGAIN == 0 and total.any():
                    width = round(width_of_gaps(total, fallback, log.source).width_m, 2)
                counts = gap_counts(log.take(slice(t, t + 1)))
                total = counts if n_frames == 0 else total + counts
            widths[t] = width
            n_frames += 1
        whole = log if context is None else context.then(log)
        before = len(whole) - len(log)
        all_widths = np.concatenate([np.full(before, widths[0] if len(log) else width), widths])
        seen = read_lines(whole, all_widths, parameters, kernel=kernel)
        now = SeenLines(seen.offset_m[before:], seen.kind[before:], seen.motion[before:])
        likelihood = _likelihood(now, widths, model, parameters, kernel, known)
        # Whether a line of the frame before was held shows in the one before that.
        context = whole.take(slice(max(0, len(whole) - 2), None))
        return Evidence({NODES: likelihood}, {"LineMotion": now.motion})

    return give


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
    widths = np.full(len(log), fallback)
    total = gap_counts(log.take(slice(0, 0)))
    for start in range(0, len(log), LOOK_AGAIN):
        block = slice(start, start + LOOK_AGAIN)
        if total.any():
            so_far = width_of_gaps(total, fallback, log.source)
            widths[block] = round(so_far.width_m, 2)
        total = total + gap_counts(log.take(block))
    _say(whole)
    return widths


def _say(found: LaneWidth) -> None:
    warnings.warn(found.message, UserWarning, stacklevel=2)


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


def _likelihood(
    seen: SeenLines,
    widths: FloatArray,
    model: LineModel,
    parameters: Parameters,
    kernel: bool,
    known: dict[float, LineTables],
) -> FloatArray:
    """known: the tables so far, by width."""
    run: Any
    if kernel:
        from egolane_pgm.evidence._line_geometry_kernel import weigh_positions as run
    else:
        from egolane_pgm.evidence._line_geometry_numpy import weigh_positions as run
    n_positions = model.n_lanes * int(number(parameters["cells"]))
    likelihood = np.empty((len(widths), n_positions, 2))
    for part in _same(widths):
        width = float(widths[part.start])
        if width not in known:
            known[width] = line_tables(model, width)
        tables = known[width]
        run(
            seen.offset_m[part],
            seen.kind[part],
            tables.log_intensity,
            tables.log_mean,
            tables.first_m,
            TABLE_STEP_M,
            tables.expected,
            tables.width_m,
            number(parameters["alpha"]),
            number(parameters["beta"]),
            likelihood[part],
        )
    return likelihood


def _same(widths: FloatArray) -> Iterator[slice]:
    """The stretches of one width."""
    if len(widths):
        ends: BoolArray = np.diff(widths) != 0
        starts = [0, *(np.flatnonzero(ends) + 1).tolist(), len(widths)]
        for a, b in pairwise(starts):
            yield slice(a, b)


def fit(
    log: LineLog,
    lane: IntArray,
    is_used: BoolArray,
    n_lanes: int,
    parameters: Parameters,
) -> dict[str, Value]:
    """The model's parameters, learned from the frames is_used (T,) with the lanes (T,), 1 to n:
    the other frames' lanes are not looked at.

    The first guess is what the parameters say; it is worth `_line_em.STRENGTH` frames of each
    lane. A lane without a frame keeps it, with a warning.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        widths = frame_widths(log, {**parameters, "lane_width_m": "auto"})
    width = parameters["lane_width_m"]
    if not isinstance(width, str):
        widths[:] = number(width)
    seen = read_lines(log, widths, parameters)
    used = np.flatnonzero(is_used & ~log.is_missing)
    for k in range(1, n_lanes + 1):
        if not (lane[used] == k).any():
            warnings.warn(
                f"{log.source}: no frame to learn from has lane {k}; it keeps its first guess",
                UserWarning,
                stacklevel=2,
            )
    if not len(used):
        return {}
    model, _ = fit_lines(
        seen.offset_m[used],
        seen.kind[used],
        lane[used] - 1,
        line_model(n_lanes, parameters),
        float(widths[0]),
        int(number(parameters["cells"])),
    )
    found: dict[str, Value] = {
        name: tuple(np.asarray(getattr(model, field)).ravel().tolist())
        for name, field in FITTED.items()
    }
    return {**found, "fallback_width_m": float(widths[0])}
