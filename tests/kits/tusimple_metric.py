"""The official metric of the TuSimple lane challenge, and its rows from a detector's lines.

Written from the challenge's description (github TuSimple/tusimple-benchmark, doc/lane_detection): a
point is right if it is within 20 pixels of the label's along the row, more for a line that leans,
and a line is found if 85 % of its rows are right. A row where both say "absent" is right as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, road_to_image

ABSENT = -2.0
PIXELS, SHARE = 20.0, 0.85

#: The metric counts this many labelled lines; a fifth one may be missed.
MOST = 4

#: Distances ahead at which a line is brought into the picture, metres.
_AHEAD_M = np.geomspace(2.0, 300.0, 2000)[::-1]


@dataclass(frozen=True)
class Score:
    """Of one picture or, as means, of several. accuracy: share of points. fp: share of the given
    lines that are none; fn: share of the labelled ones not found."""

    accuracy: float
    fp: float
    fn: float

    def __str__(self) -> str:
        return f"accuracy {self.accuracy:.3f}, FP {self.fp:.3f}, FN {self.fn:.3f}"


def score(lines: ArrayLike, labels: ArrayLike, rows: ArrayLike) -> Score:
    """The score of one picture.

    - lines (B, R), labels (A, R): the column of each line in each row, negative where it is absent
    - rows (R,)
    """
    v = np.asarray(rows, dtype=float)
    true = np.asarray(labels, dtype=float).reshape(-1, len(v))
    given = np.asarray(lines, dtype=float).reshape(-1, len(v))
    if len(given) > len(true) + 2:
        return Score(0.0, 0.0, 1.0)
    leaning = np.array([_angle(line, v) for line in true])
    tolerance = PIXELS / np.cos(leaning)
    away = np.abs(_marked(given)[None] - _marked(true)[:, None])
    right = (away < tolerance[:, None, None]).mean(axis=2)
    best = right.max(axis=1, initial=0.0)
    n_found = int((best >= SHARE).sum())
    missed, total = len(true) - n_found, float(best.sum())
    if len(true) > MOST:
        missed, total = max(missed - 1, 0), total - float(best.min())
    counted = max(min(MOST, len(true)), 1)
    fp = (len(given) - n_found) / len(given) if len(given) else 0.0
    return Score(total / counted, fp, missed / counted)


def mean(scores: Sequence[Score]) -> Score:
    """The mean of several pictures, as the challenge has it."""
    return Score(*np.mean([(s.accuracy, s.fp, s.fn) for s in scores], axis=0).tolist())


def rows_of(shape: FloatArray, camera: Camera, rows: ArrayLike, top: float = 0.0) -> FloatArray:
    """The columns (L, R) of lines y(x), (L, 4), in rows of the picture, absent above the row
    `top`, beyond the horizon and beside the picture."""
    v = np.asarray(rows, dtype=float)
    powers = np.stack([_AHEAD_M**k / k_factorial for k, k_factorial in enumerate((1, 1, 2, 6))])
    out = np.full((len(shape), len(v)), ABSENT)
    for k, line in enumerate(shape):
        column, row = road_to_image(camera, _AHEAD_M, line @ powers)
        seen = np.isfinite(column) & np.isfinite(row)
        rising = np.maximum.accumulate(row[seen])
        here = np.interp(v, rising, column[seen], left=np.nan, right=np.nan)
        is_in = np.isfinite(here) & (here >= 0) & (here < camera.width) & (v >= top)
        out[k, is_in] = here[is_in]
    return out


def _marked(columns: FloatArray) -> FloatArray:
    return np.where(columns >= 0, columns, -100.0)


def _angle(line: FloatArray, rows: FloatArray) -> float:
    """How far a line leans from upright, radians."""
    seen = line >= 0
    if seen.sum() < 2:
        return 0.0
    return float(np.arctan(np.polyfit(rows[seen], line[seen], 1)[0]))
