"""Lines as what they are: measurements of where the road's lines lie. Evidence about the place on
the road (`graphs.position_in_lane`) instead of votes for lanes.

Each lane predicts where lines are seen and how often (`_line_model`). With p_l(u) the likelihood of
a frame's lines at u in lane l and pbar(u) that of their mean intensity over the lanes, the joint
likelihood of RoadPosition and SensorState is

    OK:  pbar(u)^beta (p_l(u) / pbar(u))^alpha        BAD:  pbar(u)^beta

alpha and beta are small because the errors of neighbouring frames are much alike: the filter would
count each of them as news. They are those of a tenth of a second; a frame that comes later after
the one before weighs more, up to 1, and one that comes sooner less. A working sensor tells lane and
place inside it, a failing one only the place.

A line that the detector could not measure and holds where it was (offset the same to the last
digit, LRI falling or unknown) says nothing new: it is no evidence, and not followed. Offsets of
exactly 0 are placeholders. LineMotion is the median displacement of the lines that were measured in
this frame and the one before, matched to the nearest.

A detector that never says that a line is continuous is taken for one that cannot tell. What its
other flags, its LRI and its unit mean is told from the recording (`_line_detector`,
`_line_reading`, `_lane_width`), and said where it is not as usual.

No label is needed: where `rates` and the like are `generic`, they are the same for every detector,
and the lane width is estimated from the gaps between lines.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.fitting import fit_lines
from egolane_pgm.evidence.line_geometry.habits import (
    FULL_LRI,
    Habits,
    Tally,
    as_usual,
    habits,
    tally,
    total,
    usual,
)
from egolane_pgm.evidence.line_geometry.lane_width import gap_counts, rounded, width_of_gaps
from egolane_pgm.evidence.line_geometry.model import (
    FITTED,
    TABLE_STEP_M,
    LineModel,
    LineTables,
    line_model,
    line_tables,
    without_flags,
)
from egolane_pgm.evidence.line_geometry.parameters import PARAMETERS
from egolane_pgm.evidence.line_geometry.reading import (
    LOOK_AGAIN,
    SeenLines,
    count_once,
    frame_weights,
    in_metres,
    one_width,
    read_lines,
    recording_width,
    say_doubles,
    say_places,
)
from egolane_pgm.parameters import Parameters, Value, number
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog, stacked

NODES = ("RoadPosition", "SensorState")
PROVIDES = (NODES,)

#: What `fit` learns.
LEARNED = (*FITTED, "fallback_width_m")

#: Parameters that `fit` does not look at: settings that differ in these only share what is learned.
FIT_IGNORES = ("alpha", "beta")


def looks_ahead(parameters: Parameters) -> str | None:
    """How the evidence of a frame depends on later frames, or None where it does not."""
    if parameters["lane_width_m"] == "causal":
        return None
    what = "what the detector's flags and LRI mean"
    if isinstance(parameters["lane_width_m"], str):
        what = f"the lane width and {what}"
    return f"{what} are taken from the whole recording (lane_width_m: causal looks back only)"


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """(RoadPosition, SensorState) (T, n cells, 2), each frame's largest 1, and the input
    LineMotion (T,).

    parameters: resolved values of PARAMETERS. What lane width was found in the whole recording,
    and what is odd about its lines, is said in warnings. With
    `lane_width_m: causal` nothing of the whole recording enters the evidence: each frame's is what
    `online` gives for it.
    """
    recorded = log
    log, detector = usual(log)
    width = recording_width(log, parameters)
    log, widths = in_metres(log, np.full(len(log), width), parameters)
    say_places(log, widths)
    held = detector.repeats_are_held
    seen = read_lines(log, widths, parameters, repeats_are_held=held)
    lines = seen.lines.sum(axis=0)
    say_doubles(lines, log.source)
    if parameters["lane_width_m"] == "causal":
        return online(n_lanes, parameters)(recorded)
    seen = count_once(seen, lines)
    model = line_model(n_lanes, parameters)
    if not log.is_continuous.any():
        model = without_flags(model)
    likelihood = _likelihood(seen, widths, frame_weights(log)[0], model, parameters, {})
    return Evidence({NODES: likelihood}, {"LineMotion": seen.motion})


def online(n_lanes: int, parameters: Parameters) -> Callable[[LineLog], Evidence]:
    """Returns a function that gives the evidence of one frame after the other, or of some at a
    time, each log following on the one before.

    All that it knows comes from the frames so far, however they are grouped: the lane width (unless
    given), what the detector's flags and LRI mean, and whether it reports lines twice. From the
    first continuous line on, the detector is one that can tell. What was found is not said.
    """
    flagged = line_model(n_lanes, parameters)
    model = flagless = without_flags(flagged)
    known: dict[float, LineTables] = {}
    given = parameters["lane_width_m"]
    fallback = number(parameters, "fallback_width_m")
    width = fallback if isinstance(given, str) else number(parameters, "lane_width_m")
    context: LineLog | None = None
    n_frames, last_s = 0, -math.inf
    gaps: FloatArray = np.zeros(1)
    detector = Habits(FULL_LRI, says_valid=True, says_continuous=True)
    tallies: list[Tally] = []
    lines = np.zeros(2, dtype=np.int64)

    def look_again(source: str) -> None:
        nonlocal width, model, detector
        tallies[:] = [total(tallies)]
        detector = habits(tallies[0], source)
        if not detector.says_continuous:
            model = flagless
            known.clear()
        if isinstance(given, str) and gaps.any():
            width = rounded(width_of_gaps(gaps, fallback, source).width_m)

    def give_alike(recorded: LineLog) -> Evidence:
        """For frames that are all read in the same way."""
        nonlocal context, n_frames, gaps, lines, model, last_s
        if n_frames and n_frames % LOOK_AGAIN == 0:
            look_again(recorded.source)
        tallies.append(tally(recorded))
        piece = as_usual(recorded, detector)
        if isinstance(given, str):
            gaps = gaps + gap_counts(piece)
        if model is not flagged and piece.is_continuous.any():
            model = flagged
            known.clear()
        log = piece if context is None else context.then(piece)
        before = len(log) - len(piece)
        n_frames += len(piece)
        # Whether a line of the frame before was held shows in the one before that.
        context = log.take(slice(max(0, len(log) - 2), None))
        scaled, widths = in_metres(log, np.full(len(log), width), parameters)
        held = detector.repeats_are_held
        seen = read_lines(scaled, widths, parameters, repeats_are_held=held)
        now = SeenLines(
            seen.offset_m[before:],
            seen.kind[before:],
            seen.motion[before:],
            seen.is_double[before:],
        )
        of_frame = now.lines
        now = count_once(now, lines + of_frame.cumsum(axis=0))
        lines = lines + of_frame.sum(axis=0)
        weights, last_s = frame_weights(recorded, last_s)
        likelihood = _likelihood(now, widths[before:], weights, model, parameters, known)
        return Evidence({NODES: likelihood}, {"LineMotion": now.motion})

    def give(recorded: LineLog) -> Evidence:
        looks = np.arange(-n_frames % LOOK_AGAIN, len(recorded), LOOK_AGAIN)
        starts = np.unique([0, *looks])
        is_continuous = np.asarray(recorded.is_continuous.any(axis=1))
        # The first frame with a continuous line may change how lines are read.
        firsts = [
            a + int(np.argmax(is_continuous[a:b]))
            for a, b in pairwise([*starts, len(recorded)])
            if is_continuous[a:b].any()
        ]
        cuts = [*np.unique([*starts, *firsts]).tolist(), len(recorded)]
        parts = [give_alike(recorded.take(slice(a, b))) for a, b in pairwise(cuts)]
        return Evidence(
            {NODES: np.concatenate([part.likelihoods[NODES] for part in parts])},
            {"LineMotion": np.concatenate([part.inputs["LineMotion"] for part in parts])},
        )

    return give


def _likelihood(
    seen: SeenLines,
    widths: FloatArray,
    weights: FloatArray,
    model: LineModel,
    parameters: Parameters,
    known: dict[float, LineTables],
) -> FloatArray:
    """known: the tables so far, by width."""
    n_positions = model.n_lanes * int(number(parameters, "cells"))
    alpha, beta = (_weighted(number(parameters, name), weights) for name in ("alpha", "beta"))
    likelihood = np.empty((len(widths), n_positions, 2))
    for part in _same(widths):
        width = float(widths[part.start])
        if width not in known:
            known[width] = line_tables(model, width)
        tables = known[width]
        kernels.weigh_positions(
            seen.offset_m[part],
            seen.kind[part],
            tables.log_intensity,
            tables.log_mean,
            tables.first_m,
            TABLE_STEP_M,
            tables.expected,
            tables.width_m,
            alpha[part],
            beta[part],
            likelihood[part],
        )
    return likelihood


def _weighted(exponent: float, weights: FloatArray) -> FloatArray:
    """(T,): the exponent of each frame; lines never count more than once."""
    return np.minimum(exponent * weights, max(exponent, 1.0))


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
    for recorded, lane, is_used in parts:
        log, detector = usual(recorded, say=False)
        log, widths = in_metres(log, np.full(len(log), one_width(log, parameters)), parameters)
        width = float(widths[0]) if len(widths) else number(parameters, "fallback_width_m")
        first_width = first_width or width
        held = detector.repeats_are_held
        seen = read_lines(log, widths, parameters, repeats_are_held=held)
        seen = count_once(seen, seen.lines.sum(axis=0))
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
    model, _ = fit_lines(
        stacked(offsets, 0.0),
        stacked(kinds, -1),
        known,
        line_model(n_lanes, parameters),
        first_width,
        int(number(parameters, "cells")),
        strength=number(parameters, "prior_frames"),
    )
    found: dict[str, Value] = {
        name: tuple(np.asarray(getattr(model, field)).ravel().tolist())
        for name, field in FITTED.items()
    }
    return {**found, "fallback_width_m": first_width}
