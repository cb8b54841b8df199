"""Measure the painted share of a line, which distinguishes continuous from dashed lines.

The contours that lines are fitted to cannot: on worn concrete they miss half of a faint yellow
line, and far ahead the dashes run together. So the first metres in view are measured again, in the
picture's pixels and in the brightest of the three colours, in which yellow is as bright as white.
"""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.camera.picture import Image, rectangle
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

PARAMETERS = (
    Parameter(
        "paint_width_m",
        "positive",
        0.4,
        "width of the widest strip that counts as paint (top-hat), metres",
        highest=10,
    ),
    Parameter(
        "paint_share",
        "probability",
        0.15,
        "least contrast of paint, as a share of the line's brightest tenth",
    ),
)

#: Length of a line that is measured, metres.
_LENGTH_M = 10.0

#: Shortest measured part in view, metres.
_LEAST_M = 3.0

#: Largest distance of paint from the line, metres.
_REACH_M = 0.25

#: Least contrast of paint, as a share of local brightness.
_LEAST = 0.14

#: Least contrast of paint, as a multiple of the contrast next to the line (on the side with less).
_OVER_NOISE = 2.0

#: A line with a longer gap, metres, is broken even if its strokes are longer than its gaps (block
#: marking of exit lanes).
_GAP_M = 2.0

#: Largest painted share of a broken line.
_BROKEN = 0.5

#: Added to the local brightness (grey levels), so that noise in the dark does not count as paint.
_DARK = 10.0


def painted_share(
    view: BirdsEye, image: Image, shape: FloatArray, parameters: Parameters
) -> FloatArray:
    """Return the painted share (M,) of lines (M, 4), over their first metres in view; NaN if too
    little of a line is in view.

    image: (H, W, 3), blue green red.
    """
    width_m = number(parameters, "paint_width_m")
    aside = round((_REACH_M + width_m) / view.across_m) + 1
    strip = rectangle(1, 2 * max(round(width_m / view.across_m / 2), 1) + 1)
    away_m = np.arange(aside + 1) * view.across_m
    near = int((away_m <= _REACH_M + 1e-9).sum()) - 1
    far = min(int((away_m <= _REACH_M + view.across_m).sum()), aside)
    shares = np.full(len(shape), np.nan)
    for k, line in enumerate(shape):
        rows, columns = _rows_in_view(view, line, aside)
        if len(rows) * view.along_m < _LEAST_M:
            continue
        pixels = view.map_uv[0][rows[:, None], columns[:, None] + np.arange(-aside, aside + 1)]
        seen = np.maximum.reduce(
            cv2.split(cv2.remap(image, pixels, np.zeros(0), cv2.INTER_NEAREST))
        )
        paint = cv2.morphologyEx(seen, cv2.MORPH_TOPHAT, strip)
        local = seen.mean(axis=1) + _DARK
        # Paint belongs to the line up to `near` pixels from it, and not from `far` on.
        own = paint[:, aside - near : aside + near + 1].max(axis=1) / local
        left = paint[:, : aside - far + 1].max(axis=1)
        right = paint[:, aside + far :].max(axis=1)
        least = max(
            _LEAST,
            number(parameters, "paint_share") * _quantile(own, 0.9),
            _OVER_NOISE * _quantile(np.minimum(left, right) / local, 0.5),
        )
        painted = np.flatnonzero(own > least)
        shares[k] = len(painted) / len(own)
        if np.diff(painted, prepend=painted[:1]).max(initial=0) * view.along_m > _GAP_M:
            shares[k] = min(shares[k], _BROKEN)
    return shares


def _rows_in_view(view: BirdsEye, line: FloatArray, aside: int) -> tuple[IntArray, IntArray]:
    """Return the rows of a view that show the first metres of a line (4,), from near to far, with
    that number of columns on either side, and the line's columns in these rows, (N,) each."""
    x = view.x_m
    y = line[0] + x * (line[1] + x * (line[2] / 2 + x * line[3] / 6))
    columns = np.floor((y - view.y_m[0]) / view.across_m + 0.5).astype(np.int64)
    rows = np.flatnonzero((columns >= aside) & (columns < view.valid.shape[1] - aside))
    both = view.valid[rows, columns[rows] - aside] & view.valid[rows, columns[rows] + aside]
    rows = rows[both][::-1]
    rows = rows[x[rows] <= x[rows[:1]] + _LENGTH_M]
    return rows, columns[rows]


def _quantile(values: FloatArray, share: float) -> float:
    """Return np.quantile, many times faster for such short arrays."""
    ordered = np.sort(values)
    at = share * (len(ordered) - 1)
    below = ordered[int(at)]
    above = ordered[min(int(at) + 1, len(ordered) - 1)]
    return float(below + (above - below) * (at - int(at)))
