"""The width of a lane in the detector's metres, from the gaps between its lines; no labels.

Lines lie on a lattice whose step is the lane width. For every candidate width, a gap between two
lines of a frame is a whole number of steps plus noise, or has nothing to do with the lattice; the
candidate of largest mean log likelihood per gap, relative to gaps of no lattice, is the answer.
Half the true width explains every gap as well, but twice as many places, at half the density: it
is ln 2 behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: Candidates, metres: from detectors that report half the distance to wide lanes.
NARROWEST, WIDEST, STEP = 1.5, 6.0, 0.02

#: Noise of a gap, metres, and the share of gaps that have nothing to do with the lattice.
GAP_SIGMA_M, OFF_LATTICE = 0.2, 0.2

#: Gaps of more than so many lanes say little, and are left out.
MOST_LANES = 3

#: A line counts from this LRI on (unknown LRI counts).
STRONG_LRI = 6.0

#: Fewer gaps than this, a mean log likelihood that is not above this, a runner-up (a maximum
#: elsewhere) closer than this, all natural logs per gap: unsure.
ENOUGH_GAPS, LEAST_GAIN, LEAST_LEAD = 100, -0.35, 0.15

_BIN = 0.02
_CANDIDATES = np.arange(NARROWEST, WIDEST + STEP / 2, STEP)
_EDGES = np.arange(0.8, MOST_LANES * WIDEST + 1, _BIN)


@dataclass(frozen=True)
class LaneWidth:
    """What was found. width_m: the answer, the fallback where unsure. is_sure. found_m: the best
    candidate, NaN without gaps. gaps: how many were seen. on_lattice: the share of them within two
    sigma of a whole number of found widths. lead: of the best candidate over the runner-up, natural
    log per gap. message: all of it, one line."""

    width_m: float
    is_sure: bool
    found_m: float
    gaps: int
    on_lattice: float
    lead: float
    message: str


def lane_width(log: LineLog, fallback_m: float) -> LaneWidth:
    """The lane width of a whole recording."""
    return width_of_gaps(gap_counts(log), fallback_m, log.source)


def gap_counts(log: LineLog) -> FloatArray:
    """(B,): how many gaps between neighbouring strong lines of a frame, and between every other
    one, are in each bin; for `width_of_gaps`, added up over the logs that count."""
    return np.asarray(_counts_of_parts(log, np.zeros(len(log), dtype=np.int64), 1)[0])


def widths_so_far(log: LineLog, every: int, fallback_m: float) -> FloatArray:
    """(N,): for each stretch of `every` frames the lane width from the frames before it, rounded
    to centimetres; the fallback for the first and wherever unsure."""
    part = np.arange(len(log)) // every
    n_parts = int(part[-1]) + 1 if len(log) else 0
    before = np.zeros((n_parts, len(_EDGES) - 1))
    before[1:] = np.cumsum(_counts_of_parts(log, part, n_parts)[:-1], axis=0)
    scores = before @ _log_likelihood()
    widths = np.full(n_parts, fallback_m)
    for k in np.flatnonzero(before.any(axis=1)):
        widths[k] = round(_answer(before[k], scores[k], fallback_m, log.source).width_m, 2)
    return widths


def _counts_of_parts(log: LineLog, part: IntArray, n_parts: int) -> FloatArray:
    """(N, B): the gaps of each part; part (T,) is the one that each frame belongs to."""
    n_bins = len(_EDGES) - 1
    counts = np.zeros(n_parts * n_bins)
    offsets = np.sort(np.where(_strong(log), log.offset_m, np.inf), axis=1)
    for apart in (1, 2):
        if offsets.shape[1] > apart:
            frame, line = np.nonzero(np.isfinite(offsets[:, apart:]))
            gaps = offsets[frame, line + apart] - offsets[frame, line]
            is_near = gaps < _EDGES[-1]
            where = np.floor((gaps[is_near] - _EDGES[0]) / _BIN).astype(np.int64)
            inside = (where >= 0) & (where < n_bins)
            cell = part[frame[is_near][inside]] * n_bins + where[inside]
            counts += np.bincount(cell, minlength=len(counts))
    return counts.reshape(n_parts, n_bins)


def width_of_gaps(counts: FloatArray, fallback_m: float, source: str) -> LaneWidth:
    """The answer from the counts (B,) of all gaps."""
    return _answer(counts, counts @ _log_likelihood(), fallback_m, source)


def _answer(counts: FloatArray, total: FloatArray, fallback_m: float, source: str) -> LaneWidth:
    """total: the summed log likelihood of the gaps under each candidate."""
    n_gaps = int(counts.sum())
    if n_gaps == 0:
        message = f"{source}: no two lines in one frame to tell the lane width from"
        return _unsure(fallback_m, math.nan, 0, 0.0, 0.0, message)
    score = total / n_gaps
    best = int(score.argmax())
    others = np.abs(_CANDIDATES / _CANDIDATES[best] - 1) > 0.15
    lead = float(score[best] - score[others].max())
    width = float(_CANDIDATES[best] + _peak(score, best) * STEP)
    centres = _EDGES[:-1] + _BIN / 2
    distance = np.abs(centres - np.maximum(1, np.round(centres / width)) * width)
    share = float(counts[distance < 2 * GAP_SIGMA_M].sum() / n_gaps)
    found = (
        f"{width:.2f} m from {n_gaps} gaps between lines, {100 * share:.0f} % of them on the"
        " lattice"
    )
    on_edge = best in (0, len(_CANDIDATES) - 1)
    if n_gaps < ENOUGH_GAPS or score[best] < LEAST_GAIN or lead < LEAST_LEAD or on_edge:
        return _unsure(
            fallback_m, width, n_gaps, share, lead, f"{source}: lane width unsure ({found})"
        )
    return LaneWidth(width, True, width, n_gaps, share, lead, f"{source}: lane width {found}")


def _unsure(
    fallback_m: float, found_m: float, gaps: int, share: float, lead: float, message: str
) -> LaneWidth:
    message += f"; {fallback_m:g} m is used"
    return LaneWidth(fallback_m, False, found_m, gaps, share, lead, message)


def _strong(log: LineLog) -> BoolArray:
    reliable = np.isnan(log.lri) | (log.lri >= STRONG_LRI)
    # Offsets of exactly 0 are placeholders of detectors that have not measured yet.
    with np.errstate(invalid="ignore"):
        placed = np.isfinite(log.offset_m) & (np.abs(log.offset_m) > 1e-6)
    return log.is_valid & reliable & placed


@lru_cache(maxsize=1)
def _log_likelihood() -> FloatArray:
    """(B, candidates): of a gap in each bin, relative to gaps that are uniform over a lane."""
    centres = (_EDGES[:-1] + _BIN / 2)[:, None]
    lanes = np.maximum(1, np.round(centres / _CANDIDATES))
    z = (centres - lanes * _CANDIDATES) / GAP_SIGMA_M
    normal = np.exp(-0.5 * z**2) / (GAP_SIGMA_M * math.sqrt(2 * math.pi))
    near = lanes <= MOST_LANES
    return np.asarray(
        np.log((1 - OFF_LATTICE) * np.where(near, normal * _CANDIDATES, 0) + OFF_LATTICE)
    )


def _peak(score: FloatArray, best: int) -> float:
    """Where between its neighbours a maximum lies, in steps: the vertex of the parabola."""
    if best in (0, len(score) - 1):
        return 0.0
    left, middle, right = score[best - 1 : best + 2]
    curve = left - 2 * middle + right
    return float(0.5 * (left - right) / curve) if curve < 0 else 0.0
