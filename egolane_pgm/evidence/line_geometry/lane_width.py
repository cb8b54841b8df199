"""The width of a lane in the detector's metres, from the gaps between its lines; no labels.

Lines lie on a lattice whose step is the lane width. For every candidate width, a gap between two
lines of a frame is a whole number of steps plus noise, or has nothing to do with the lattice, as
the share of gaps does that fits best. Half the true width explains every gap as
well, but twice as many places, at half the density: it is ln 2 per gap behind. The most probable
candidate is the answer, with widths near the expected one more probable beforehand. But a width
by which no two neighbouring lanes are ever seen at once is that of no lanes: a line half a lane
beside the road fits half their width.

All of it is relative to the gaps themselves, so that detectors that do not count in metres are
served too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from egolane_pgm.evidence.line_geometry.habits import is_placed
from egolane_pgm.evidence.line_geometry.model import STRONG_LRI
from egolane_pgm.types import BoolArray, FloatArray, LineLog

#: Gaps are counted in bins of one per cent, from the smallest to the largest (any unit).
_STEP = 0.01
_SMALLEST, _LARGEST = 1e-3, 1e5

#: Candidates, in medians of the largest gap between neighbours of each frame: it is a lane where
#: all lines are seen, several where some are missed.
NARROWEST, WIDEST = 0.2, 1.5

#: Gaps of more than so many lanes have nothing to do with the lattice. Every other line, those
#: between missed, is four away: with less, twice the width would explain gaps that the width does
#: not.
MOST_LANES = 4

#: Noise of a gap, lane widths: lines lie within .15 m or so of their place.
GAP_SIGMA = 0.06

#: A gap of less than this share of the frame's largest one is no lane: the line is there twice.
DOUBLE = 0.1

#: What is tried for the share of gaps that have nothing to do with the lattice.
OFF_LATTICE = (0.05, 0.3, 0.6, 0.9)

#: Neighbouring frames show the same lines, two seconds of them are hardly more than one look:
#: so many gaps count as one.
ALIKE = 20

#: Of the gaps between every other line, at least this share is two lanes, give or take so many lane
#: widths. Looked at where there are enough to see some three of them that are not alike (a detector
#: may report two lines only).
LEAST_PAIRS, PAIR_WITHIN = 0.03, 0.15
ENOUGH_PAIRS = 3 * ALIKE / LEAST_PAIRS

#: Widths about the expected one are more probable: half as much a tenth away (of a Cauchy
#: distribution of the logarithm, which leaves a chance to those far away).
EXPECTED_WITHIN = 0.1

#: Sure from these odds on, natural log, against no lattice and against a maximum elsewhere.
LEAST_ODDS = math.log(20)

_N_BINS = math.ceil(math.log(_LARGEST / _SMALLEST) / _STEP)
_N_CANDIDATES = math.ceil(math.log(WIDEST / NARROWEST) / _STEP) + 1
#: The gaps that candidates are judged by, in bins from the one of the narrowest candidate.
_BELOW = math.floor(math.log(0.5) / _STEP)
_N_WINDOW = _N_CANDIDATES + math.ceil(math.log(MOST_LANES + 0.5) / _STEP) - _BELOW
#: Candidates nearer than this to another are the same maximum.
_APART = math.ceil(math.log(1.15) / _STEP)


@dataclass(frozen=True)
class LaneWidth:
    """What was found. width_m: the answer, the fallback where unsure. is_sure. found_m: the best
    candidate, NaN without gaps. gaps: how many were seen. on_lattice: the share of them within two
    sigma of a whole number of found widths. odds: of the best candidate against the runner-up or no
    lattice, whichever is better, natural log. message: all of it, one line."""

    width_m: float
    is_sure: bool
    found_m: float
    gaps: int
    on_lattice: float
    odds: float
    message: str


def lane_width(log: LineLog, fallback_m: float) -> LaneWidth:
    """The lane width of a whole recording."""
    return width_of_gaps(gap_counts(log), fallback_m, log.source)


def gap_counts(log: LineLog) -> FloatArray:
    """(3, B): how many gaps between neighbouring strong lines of a frame are in each bin, how many
    between every other one, and how many frames have their largest gap between neighbours there.
    For `width_of_gaps`, added up over the logs that count."""
    counts = np.zeros((3, _N_BINS))

    def add(kind: int, gaps: FloatArray) -> None:
        inside = gaps[(gaps > _SMALLEST) & (gaps < _LARGEST)]
        where = (np.log(inside / _SMALLEST) / _STEP).astype(np.int64)
        counts[kind] += np.bincount(np.minimum(where, _N_BINS - 1), minlength=_N_BINS)

    offsets = np.sort(np.where(_strong(log), log.offset_m, np.inf), axis=1)
    if offsets.shape[1] < 2:
        return counts
    offsets = offsets[np.isfinite(offsets[:, 1])]
    gaps = _gaps(offsets, 1)
    largest = gaps.max(axis=1)
    is_double = gaps < DOUBLE * largest[:, None]
    is_double &= np.isfinite(offsets[:, 1:])
    if is_double.any():
        offsets[:, 1:][is_double] = np.inf
        offsets.sort(axis=1)
    add(2, largest)
    for apart in range(1, min(3, offsets.shape[1])):
        gaps = _gaps(offsets, apart)
        add(apart - 1, gaps[gaps != 0])
    return counts


def rounded(width_m: float) -> float:
    """To centimetres; three digits of a width in another unit."""
    return float(f"{width_m:.3g}") if width_m < 1 or width_m >= 10 else round(width_m, 2)


def width_of_gaps(counts: FloatArray, fallback_m: float, source: str) -> LaneWidth:
    """The answer from the counts (3, B) of all gaps."""
    frames = counts[2].cumsum()
    middle = int(np.argmax(frames >= max(frames[-1] / 2, 0.5)))
    # The bin of the narrowest candidate.
    first = middle + round(math.log(NARROWEST) / _STEP)
    bins = first + _BELOW + np.arange(_N_WINDOW)
    is_bin = (bins >= 0) & (bins < _N_BINS)
    near = np.where(is_bin, counts[:2, np.clip(bins, 0, _N_BINS - 1)], 0.0)
    of_gap, is_pair = _tables()
    fit = (near.sum(axis=0) @ of_gap).reshape(len(OFF_LATTICE), -1).max(axis=0) / ALIKE
    n_pairs = counts[1].sum()
    may_be = (n_pairs < ENOUGH_PAIRS) | (near[1] @ is_pair >= LEAST_PAIRS * n_pairs)
    return _answer(counts[:2].sum(axis=0), first, fit, may_be, fallback_m, source)


def _gaps(offsets: FloatArray, apart: int) -> FloatArray:
    """(T, L - apart): between sorted lines so many places apart; 0 where there is no other."""
    is_there = np.isfinite(offsets[:, apart:])
    return np.subtract(
        offsets[:, apart:], offsets[:, :-apart], out=np.zeros(is_there.shape), where=is_there
    )


def _answer(
    counts: FloatArray,
    first: int,
    fit: FloatArray,
    may_be: BoolArray,
    fallback_m: float,
    source: str,
) -> LaneWidth:
    """fit: of each candidate, the log likelihood relative to no lattice, as many gaps counted as
    one as are alike. may_be: whether two such lanes are seen at once."""
    n_gaps = int(counts.sum())
    if not n_gaps:
        message = f"{source}: no two lines in one frame to tell the lane width from"
        return _unsure(fallback_m, math.nan, n_gaps, 0.0, 0.0, message)
    log_width = math.log(_SMALLEST) + _STEP * (first + np.arange(_N_CANDIDATES) + 0.5)
    away = (log_width - math.log(fallback_m)) / EXPECTED_WITHIN
    # Those that cannot be come after all others, in their order.
    score = fit - np.log1p(away**2) - np.where(may_be, 0.0, 1e9)
    best = int(score.argmax())
    others = np.abs(np.arange(_N_CANDIDATES) - best) > _APART
    odds = float(min(fit[best], score[best] - score[others].max()))
    width = math.exp(log_width[best] + _peak(fit, best) * _STEP)
    gaps = np.exp(math.log(_SMALLEST) + _STEP * (np.arange(_N_BINS) + 0.5)) / width
    is_on = np.abs(gaps - np.clip(np.round(gaps), 1, MOST_LANES)) < 2 * GAP_SIGMA
    share = float(counts[is_on].sum() / n_gaps)
    found = (
        f"{width:.{2 if width < 20 else 0}f} m from {n_gaps} gaps between lines,"
        f" {100 * share:.0f} % of them on the lattice"
    )
    is_known = odds >= LEAST_ODDS and may_be[best] and 0 < best < _N_CANDIDATES - 1
    if not is_known:
        return _unsure(
            fallback_m, width, n_gaps, share, odds, f"{source}: lane width unsure ({found})"
        )
    return LaneWidth(width, True, width, n_gaps, share, odds, f"{source}: lane width {found}")


def _unsure(
    fallback_m: float, found_m: float, gaps: int, share: float, odds: float, message: str
) -> LaneWidth:
    message += f"; {fallback_m:g} m is used"
    return LaneWidth(fallback_m, False, found_m, gaps, share, odds, message)


def _strong(log: LineLog) -> BoolArray:
    reliable = np.isnan(log.lri) | (log.lri >= STRONG_LRI)
    return log.is_valid & reliable & is_placed(log)


@lru_cache(maxsize=1)
def _tables() -> tuple[FloatArray, FloatArray]:
    """(window, shares * candidates): log likelihood of a gap in each bin, relative to gaps that
    are uniform over a lane; and (window, candidates): whether it is two lanes."""
    gap = np.exp((np.arange(-(_N_CANDIDATES - 1), _N_WINDOW) + _BELOW) * _STEP)
    lanes = np.maximum(1, np.round(gap))
    normal = np.exp(-0.5 * ((gap - lanes) / GAP_SIGMA) ** 2) / (GAP_SIGMA * math.sqrt(2 * math.pi))
    density = np.where(lanes <= MOST_LANES, normal, 0.0)

    def of_candidates(values: FloatArray) -> FloatArray:
        # Row b: candidates 0, 1, ...: the gap is b, b - 1, ... bins from theirs.
        return sliding_window_view(values, _N_CANDIDATES)[:, ::-1]

    tables = [of_candidates(np.log((1 - off) * density + off)) for off in OFF_LATTICE]
    is_pair = np.where(np.abs(gap - 2) < PAIR_WITHIN, 1.0, 0.0)
    return np.concatenate(tables, axis=1), np.ascontiguousarray(of_candidates(is_pair))


def _peak(score: FloatArray, best: int) -> float:
    """Where between its neighbours a maximum lies, in steps: the vertex of the parabola."""
    if best in (0, len(score) - 1):
        return 0.0
    left, middle, right = score[best - 1 : best + 2]
    curve = left - 2 * middle + right
    return float(np.clip(0.5 * (left - right) / curve, -0.5, 0.5)) if curve < 0 else 0.0
