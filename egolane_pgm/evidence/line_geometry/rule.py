"""The evidence rule: lines are measurements of where the road's lines lie, and so give evidence
about the car's place on the road (graph `position_in_lane`) instead of votes for lanes.

Each lane predicts where lines are reported and how often (`model`). Let p_l(u) be the likelihood of
a frame's lines for a car at u in lane l, and pbar(u) the one under their mean intensity over the
lanes. The joint likelihood of RoadPosition and SensorState is

    OK:  pbar(u)^beta (p_l(u) / pbar(u))^alpha        BAD:  pbar(u)^beta

A working sensor thus tells the lane and the place inside it, a failing one only the place. alpha
and beta are small because the errors of neighbouring frames are alike, while the filter counts each
frame as new information. They hold for a tenth of a second: a frame that comes later after the one
before weighs more, up to 1, and one that comes sooner weighs less.

A detector may hold a line that it could not measure where it was, with the same offset to the last
digit and an LRI that falls or is unknown. Such a line is no evidence and is not followed. Offsets
of exactly 0 are placeholders. LineMotion is the median displacement of the lines that were measured
in this frame and in the one before, matched to the nearest.

A detector that never reports a continuous line counts as one that cannot tell. The meaning of its
other flags, of its LRI and of its unit is estimated from the recording (`habits`, `reading`,
`lane_width`); a warning says so if it is unusual.

The rule needs no labels: `generic` constants are the same for every detector, and the lane width is
estimated from the gaps between lines.
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
    UPDATE_EVERY,
    SeenLines,
    count_once,
    frame_weights,
    in_metres,
    one_width,
    read_lines,
    recording_width,
    warn_of_doubles,
    warn_of_offsets,
)
from egolane_pgm.parameters import Parameters, Value, number
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog, stacked

NODES = ("RoadPosition", "SensorState")
PROVIDES = (NODES,)
INPUTS = ("LineMotion",)

#: The parameters that `fit` learns.
LEARNED = (*FITTED, "fallback_width_m")

#: Parameters that `fit` ignores: settings that differ only in these share what is learned.
FIT_IGNORES = ("alpha", "beta")


def looks_ahead(parameters: Parameters) -> str | None:
    """How the evidence of a frame depends on later frames; None if it does not."""
    if parameters["lane_width_m"] == "causal":
        return None
    what = "what the detector's flags and LRI mean"
    if isinstance(parameters["lane_width_m"], str):
        what = f"the lane width and {what}"
    return f"{what} are taken from the whole recording (lane_width_m: causal looks back only)"


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """The evidence of T frames: the joint likelihood of RoadPosition and SensorState, (T, n cells,
    2), whose largest value in each frame is 1, and the input LineMotion (T,).

    parameters: checked values of PARAMETERS. With `lane_width_m: causal` the evidence of a frame is
    what `online` gives for it; otherwise the lane width and the detector's habits come from the
    whole recording.

    Warnings say which lane width was found, and what is unusual about the lines.
    """
    recorded = log
    log, detector = usual(log)
    width = recording_width(log, parameters)
    log, widths = in_metres(log, np.full(len(log), width), parameters)
    warn_of_offsets(log, widths)
    held = detector.repeats_are_held
    seen = read_lines(log, widths, parameters, repeats_are_held=held)
    lines = seen.lines.sum(axis=0)
    warn_of_doubles(lines, log.source)
    if parameters["lane_width_m"] == "causal":
        return online(n_lanes, parameters)(recorded)
    seen = count_once(seen, lines)
    model = line_model(n_lanes, parameters)
    if not log.is_continuous.any():
        model = without_flags(model)
    likelihood = _likelihood(seen, widths, frame_weights(log)[0], model, parameters, {})
    return Evidence({NODES: likelihood}, {"LineMotion": seen.motion})


def online(n_lanes: int, parameters: Parameters) -> Callable[[LineLog], Evidence]:
    """A function that gives the evidence of one or several frames at a time; each log continues the
    one before.

    All that it knows comes from the frames so far, however they are grouped: the lane width (unless
    given), the meaning of the detector's flags and LRI, and whether it reports lines twice. The
    detector counts as one with a continuous flag from the first continuous line on. There are no
    warnings.
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

    def update_reading(source: str) -> None:
        """Estimates habits and lane width anew, from all frames so far."""
        nonlocal width, model, detector
        tallies[:] = [total(tallies)]
        detector = habits(tallies[0], source)
        if not detector.says_continuous:
            model = flagless
            known.clear()
        if isinstance(given, str) and gaps.any():
            width = rounded(width_of_gaps(gaps, fallback, source).width_m)

    def evidence_of_part(recorded: LineLog) -> Evidence:
        """The evidence of frames that are all read in the same way."""
        nonlocal context, n_frames, gaps, lines, model, last_s
        if n_frames and n_frames % UPDATE_EVERY == 0:
            update_reading(recorded.source)
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
        # Two frames are kept: they show whether a line of the last one was held.
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

    def evidence_of(recorded: LineLog) -> Evidence:
        updates = np.arange(-n_frames % UPDATE_EVERY, len(recorded), UPDATE_EVERY)
        starts = np.unique([0, *updates])
        is_continuous = np.asarray(recorded.is_continuous.any(axis=1))
        # The first frame with a continuous line may change how lines are read, so a part ends
        # there.
        firsts = [
            a + int(np.argmax(is_continuous[a:b]))
            for a, b in pairwise([*starts, len(recorded)])
            if is_continuous[a:b].any()
        ]
        cuts = [*np.unique([*starts, *firsts]).tolist(), len(recorded)]
        parts = [evidence_of_part(recorded.take(slice(a, b))) for a, b in pairwise(cuts)]
        return Evidence(
            {NODES: np.concatenate([part.likelihoods[NODES] for part in parts])},
            {"LineMotion": np.concatenate([part.inputs["LineMotion"] for part in parts])},
        )

    return evidence_of


def _likelihood(
    seen: SeenLines,
    widths: FloatArray,
    weights: FloatArray,
    model: LineModel,
    parameters: Parameters,
    known: dict[float, LineTables],
) -> FloatArray:
    """The likelihood of each frame, (T, n cells, 2). known: the tables made so far, by lane
    width."""
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
    """The exponent of each frame, (T,), limited so that no line counts more than once."""
    return np.minimum(exponent * weights, max(exponent, 1.0))


def _same(widths: FloatArray) -> Iterator[slice]:
    """The stretches of frames with the same width."""
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
    """Learns the parameters `LEARNED` from frames whose lane is known.

    - lane: (T,) 1 to n; only those of the used frames are read
    - is_used: (T,) the frames to learn from
    - parameters: the first guess, which is worth `prior_frames` frames of each lane

    A lane without a frame keeps the first guess, with a warning.
    """
    return fit_pooled([(log, lane, is_used)], n_lanes, parameters)


def fit_pooled(
    parts: Sequence[tuple[LineLog, IntArray, BoolArray]], n_lanes: int, parameters: Parameters
) -> dict[str, Value]:
    """As `fit`, from several recordings: log, lane and is_used of each. All lines are scaled to the
    lane width of the first recording."""
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
