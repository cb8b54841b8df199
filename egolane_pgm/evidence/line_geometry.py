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
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from egolane_pgm.evidence._lane_width import gap_counts, width_of_gaps
from egolane_pgm.evidence._line_em import STRENGTH, fit_lines
from egolane_pgm.evidence._line_model import (
    FITTED,
    N_CLASSES,
    TABLE_STEP_M,
    LineModel,
    LineTables,
    line_model,
    line_tables,
    without_flags,
)
from egolane_pgm.evidence._line_reading import (
    LOOK_AGAIN,
    SeenLines,
    frame_widths,
    one_width,
    read_lines,
)
from egolane_pgm.graphs._parameters import number
from egolane_pgm.graphs.position_in_lane import CELLS, MOTION_BINS, MOTION_RANGE
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

#: Parameters that `fit` does not look at: settings that differ in these only share what is learned.
FIT_IGNORES = ("alpha", "beta")

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
    Parameter(
        "prior_frames",
        "non_negative",
        STRENGTH,
        "frames of each lane that the generic constants are worth where parameters are learned;"
        " `infinite`: nothing is learned",
        choices=("infinite",),
    ),
    CELLS,
    MOTION_BINS,
    MOTION_RANGE,
)


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

    The first guess is what the parameters say; it is worth `prior_frames` frames of each lane. A
    lane without a frame keeps it, with a warning.
    """
    return fit_pooled([(log, lane, is_used)], n_lanes, parameters)


def fit_pooled(
    parts: Sequence[tuple[LineLog, IntArray, BoolArray]], n_lanes: int, parameters: Parameters
) -> dict[str, Value]:
    """As `fit`, from several recordings, (log, lane, is_used) of each, whose lines are brought to
    the lane width of the first."""
    if parameters["prior_frames"] == "infinite":
        return {p.name: p.default for p in PARAMETERS if p.name in LEARNED}
    source = ", ".join(log.source for log, _, _ in parts)
    offsets, kinds, lanes = [], [], []
    first_width = 0.0
    for log, lane, is_used in parts:
        width = one_width(log, parameters)
        first_width = first_width or width
        seen = read_lines(log, np.full(len(log), width), parameters)
        used = np.flatnonzero(is_used & ~log.is_missing)
        offsets.append(seen.offset_m[used] * (first_width / width))
        kinds.append(seen.kind[used])
        lanes.append(lane[used] - 1)
    known = np.concatenate(lanes)
    for k in range(n_lanes):
        if not (known == k).any():
            warnings.warn(
                f"{source}: no frame to learn from has lane {k + 1}; it keeps its first guess",
                UserWarning,
                stacklevel=2,
            )
    if not len(known):
        return {}
    n_lines = max(offset.shape[1] for offset in offsets)
    model, _ = fit_lines(
        _padded(offsets, n_lines, 0.0),
        _padded(kinds, n_lines, -1),
        known,
        line_model(n_lanes, parameters),
        first_width,
        int(number(parameters["cells"])),
        strength=number(parameters["prior_frames"]),
    )
    found: dict[str, Value] = {
        name: tuple(np.asarray(getattr(model, field)).ravel().tolist())
        for name, field in FITTED.items()
    }
    return {**found, "fallback_width_m": first_width}


def _padded(parts: Sequence[Any], n_lines: int, blank: float) -> Any:
    """(T, L): parts of fewer lines, with blanks, below each other."""
    wide = [np.pad(p, ((0, 0), (0, n_lines - p.shape[1])), constant_values=blank) for p in parts]
    return np.concatenate(wide)
