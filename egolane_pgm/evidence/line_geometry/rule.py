"""The evidence rule: lines are measurements of the road's lines, and so evidence of the car's place
on the road (graph `position_in_lane`) instead of votes for lanes.

Each lane predicts where lines are reported and how often (`model`). Let p_l(u) be the likelihood of
a frame's lines for a car at u in lane l, and pbar(u) the one under their mean intensity over the
lanes. The joint likelihood of RoadPosition and SensorState is

    OK:  pbar(u)^beta (p_l(u) / pbar(u))^alpha        BAD:  pbar(u)^beta

A working sensor is evidence of the lane and the place in it, a failing one of the place only. alpha
and beta are small because errors of neighbouring frames are correlated, while the filter counts
each frame as independent. They are the weights for a tenth of a second; a frame weighs in
proportion to the time since the previous one, at most 1. A pattern of lines (how many on the left
and on the right) that has been seen for long weighs little: what a sensor never shows is one fact.
A frame without lines is evidence of nothing, and so is an absent one.

A held line, which the detector did not measure but repeats with the same offset to the last digit
and an LRI that falls or is unknown, is no evidence and is not followed. Offsets of exactly 0 are
placeholders. LineMotion is the median displacement over a tick, a tenth of a second, of the lines
measured at both its ends, matched to the nearest; without such lines the last velocity is kept.

Lines are scaled to lanes of LANE_M metres, so that noise, clutter and reach are relative to the
lane width. The width has a distribution (`scale`), and likelihoods are means over its quantiles.
They are also means over kinds of detectors and roads (`visibility`): range, continuous flags, and
lines outside the road.

A detector that never reports a continuous line counts as one without this flag. The semantics of
the other flags and the LRI are estimated (`flag_semantics`), with a warning if they are unusual.

The rule needs no labels: `generic` constants are the same for every detector.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from egolane_pgm.evidence.line_geometry import flag_semantics, kernels, reading, scale
from egolane_pgm.evidence.line_geometry.fitting import fit_lines
from egolane_pgm.evidence.line_geometry.model import (
    FITTED,
    LANE_M,
    TABLE_STEP_M,
    LineModel,
    line_model,
)
from egolane_pgm.evidence.line_geometry.visibility import (
    KIND_CHANGES,
    KINDS,
    LANE_CHANGES,
    VisibilityTables,
    far_frames,
    new_patterns,
    new_visibility,
    visibility_models,
    visibility_tables,
    warn_of_own_lines,
)
from egolane_pgm.graphs.position_in_lane import motion_index
from egolane_pgm.parameters import Parameters, Value, number
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog, pad_and_concat

NODES = ("RoadPosition", "SensorState")
PROVIDES = (NODES,)
INPUTS = ("LineMotion",)

#: The parameters that `fit` learns.
LEARNED = (*FITTED, "fallback_width_m")


def looks_ahead(parameters: Parameters) -> str | None:
    """Return why the evidence of a frame depends on later frames; None if it does not."""
    if parameters["lane_width_m"] == "causal":
        return None
    what = "what the detector's flags and LRI mean"
    if isinstance(parameters["lane_width_m"], str):
        what = f"the lane width and {what}"
    return f"{what} are taken from the whole recording (lane_width_m: causal looks back only)"


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """The evidence of T frames: the joint likelihood of RoadPosition and SensorState, (T, n cells,
    2), whose largest value in each frame is 1, and the input LineMotion (T,).

    parameters: checked values of PARAMETERS. With `lane_width_m: causal` the evidence equals that
    of `online`; otherwise the lane width and the flag semantics come from the whole recording.

    Warns of the lane width found and of anything unusual about the lines.
    """
    recorded = log
    log, seen, width = reading.read_recording(recorded, parameters)
    models = visibility_models(n_lanes, parameters)
    visibility = new_visibility(n_lanes, len(models))
    if parameters["lane_width_m"] == "causal":
        given = _online(models, visibility, parameters)(recorded)
    else:
        tables = visibility_tables(models, has_flags=bool(_has_flag(log).any()))
        patterns = new_patterns()
        wanders = 1 + number(parameters, "width_wanders") * np.array([-1, 0, 1])
        widths = np.tile(width * wanders, (len(log), 1))
        given = _evidence(seen, widths, log.is_missing, tables, visibility, patterns, parameters)
    n_frames = max(len(log), 1)
    far = far_frames(log.offset_m, np.full(len(log), width)) / n_frames
    warn_of_own_lines(visibility, (seen.kind >= 0).sum() / n_frames, far, log.source)
    return given


def online(n_lanes: int, parameters: Parameters) -> Callable[[LineLog], Evidence]:
    """Return a function that gives the evidence of one or several frames, log after log.

    All estimates use the frames so far, however they are grouped: the lane width (unless given),
    the visibility, the flag semantics and the share of double lines. The detector counts as one
    with a continuous flag from the first continuous line on. Gives no warnings.
    """
    models = visibility_models(n_lanes, parameters)
    return _online(models, new_visibility(n_lanes, len(models)), parameters)


def _online(
    models: Sequence[LineModel], visibility: FloatArray, parameters: Parameters
) -> Callable[[LineLog], Evidence]:
    """As `online`; visibility: (n, K) the belief over kinds, which becomes that after each log."""
    tables = {has: visibility_tables(models, has_flags=has) for has in (True, False)}
    given = parameters["lane_width_m"]
    width = scale.new_belief(number(parameters, "fallback_width_m"))
    detector = flag_semantics.PAPER
    counts = flag_semantics.NO_LINES
    recent: list[flag_semantics.Columns] = []
    has_flags = False
    n_frames = 0
    last = reading.NO_FRAME
    patterns = new_patterns()

    def evidence_of_part(recorded: LineLog) -> Evidence:
        """Return the evidence of frames that share all estimates."""
        nonlocal detector, counts, has_flags, n_frames, last
        if n_frames and n_frames % reading.UPDATE_EVERY == 0:
            counts = flag_semantics.added(counts, flag_semantics.count_lines(recent))
            recent.clear()
            detector = flag_semantics.flag_semantics_of(counts, recorded.source)
            has_flags &= detector.uses_continuous
        recent.append(flag_semantics.columns(recorded))
        log = flag_semantics.translated(recorded, detector)
        has_flags = has_flags or bool(_has_flag(log).any())
        n_frames += len(log)
        kind, is_strong = scale.line_classes(log.offset_m, log.is_valid, log.is_continuous, log.lri)
        if isinstance(given, str):
            widths = scale.follow(width, log.offset_m, is_strong)
        else:
            widths = np.full((len(log), 1), given)
        middle = np.ascontiguousarray(widths[:, widths.shape[1] // 2])
        seen, last = reading.read_lines(log, kind, middle, detector.repeats_are_held, last)
        used = tables[has_flags]
        return _evidence(seen, widths, log.is_missing, used, visibility, patterns, parameters)

    def evidence_of(recorded: LineLog) -> Evidence:
        if len(recorded) <= 1:
            return evidence_of_part(recorded)
        # The estimates change every UPDATE_EVERY frames, and may at the first continuous line.
        n = len(recorded)
        every = reading.UPDATE_EVERY
        updates = sorted({0, *range(-n_frames % every, n, every)})
        has_flag = _has_flag(recorded)
        firsts = [a + int(has_flag[a:b].argmax()) for a, b in pairwise([*updates, n])]
        cuts = [*sorted({*updates, *firsts}), n]
        return Evidence.concat(
            [evidence_of_part(recorded.take(slice(a, b))) for a, b in pairwise(cuts)]
        )

    return evidence_of


def _has_flag(log: LineLog) -> BoolArray:
    """Return whether a line with an offset is continuous, (T,)."""
    flags = log.is_continuous & flag_semantics.is_placed(log.offset_m)
    return np.asarray(flags.any(axis=1))


def _evidence(
    seen: reading.SeenLines,
    widths: FloatArray,
    is_missing: BoolArray,
    tables: VisibilityTables,
    visibility: FloatArray,
    patterns: FloatArray,
    parameters: Parameters,
) -> Evidence:
    """The evidence of T frames. widths: (T, W) equally probable lane widths; is_missing: (T,);
    visibility, patterns: (n, K), (M, M), which become those after the last frame."""
    n_positions = len(visibility) * int(number(parameters, "cells"))
    likelihood = np.empty((len(widths), n_positions, 2))
    last_kind = np.empty(len(widths))
    kernels.weigh_positions(
        seen.offset_m,
        seen.kind,
        widths,
        tables.log_intensity,
        tables.log_mean,
        tables.first_m,
        TABLE_STEP_M,
        tables.expected,
        tables.width_m,
        number(parameters, "alpha"),
        number(parameters, "beta"),
        seen.weights,
        is_missing,
        LANE_CHANGES,
        KIND_CHANGES,
        visibility,
        patterns,
        likelihood,
        last_kind,
    )
    shows_own = (last_kind > 0.5) & (visibility.shape[1] == len(KINDS))
    motion = motion_index(seen.displacement, seen.ticks, seen.velocity, shows_own, parameters)
    return Evidence({NODES: likelihood}, {"LineMotion": motion})


def fit(
    parts: Sequence[tuple[LineLog, IntArray, BoolArray]], n_lanes: int, parameters: Parameters
) -> dict[str, Value]:
    """Learn the parameters `LEARNED` from frames whose lane is known.

    - parts: per recording its lines, lane (T,) from 1 to n, and the frames to learn from (T,). The
      first one gives the expected lane width.
    - parameters: the first guess, which is worth `fitting.STRENGTH` frames of each lane

    A lane without a frame keeps the first guess, with a warning.
    """
    source = ", ".join(log.source for log, _, _ in parts)
    offsets = []
    kinds = []
    lanes = []
    first_width = 0.0
    for recorded, lane, is_used in parts:
        with warnings.catch_warnings():
            # The evidence of the recording warns of the same.
            warnings.simplefilter("ignore")
            log, seen, width = reading.read_recording(recorded, parameters)
        is_metres = reading.NARROWEST_M <= width <= reading.WIDEST_M
        fallback = number(parameters, "fallback_width_m")
        first_width = first_width or (width if is_metres else fallback)
        used = np.flatnonzero(is_used & ~log.is_missing)
        offsets.append(seen.offset_m[used] * (LANE_M / width))
        kinds.append(seen.kind[used])
        lanes.append(lane[used] - 1)
    known = np.concatenate(lanes)
    for k in range(n_lanes):
        if not (known == k).any():
            warnings.warn(
                f"{source}: no frame to learn from has lane {k + 1}; it keeps its first guess",
                stacklevel=2,
            )
    if not len(known):
        return {}
    model = fit_lines(
        pad_and_concat(offsets, 0.0),
        pad_and_concat(kinds, -1),
        known,
        line_model(n_lanes, parameters),
        int(number(parameters, "cells")),
    )
    found: dict[str, Value] = {
        name: tuple(getattr(model, name).ravel().tolist()) for name in FITTED
    }
    return {**found, "fallback_width_m": first_width}
