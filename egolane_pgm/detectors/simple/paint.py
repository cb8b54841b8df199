"""Measures how much of a line is painted, to tell a continuous line from a dashed one.

The contours that lines are fitted to cannot tell: on worn concrete they miss half of a faint yellow
line, and far ahead the dashes run together. This module therefore looks again at the first metres
in view, in the picture's own pixels. It takes the brightest of the three colours, in which yellow
is as bright as white.
"""

from __future__ import annotations

import cv2
import numpy as np

from egolane_pgm.camera.picture import Image
from egolane_pgm.detectors.simple.birdseye import BirdsEye
from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import FloatArray, IntArray

PARAMETERS = (
    Parameter("paint_length_m", "positive", 10.0, "length of a line that is examined, metres"),
    Parameter("least_length_m", "positive", 3.0, "shortest piece in view that is judged, metres"),
    Parameter(
        "paint_width_m",
        "positive",
        0.4,
        "width of the widest strip that counts as paint (top-hat), metres",
        highest=10,
    ),
    Parameter(
        "paint_reach_m",
        "positive",
        0.25,
        "largest distance of paint from the fitted line, metres",
        highest=10,
    ),
    Parameter(
        "least_paint", "positive", 0.14, "least contrast of paint, as a share of local brightness"
    ),
    Parameter(
        "paint_share", "probability", 0.15, "the same, as a share of the line's brightest tenth"
    ),
    Parameter(
        "paint_over_noise",
        "non_negative",
        2.0,
        "the same, as a multiple of the contrast beside the line (on the side with less)",
    ),
)

#: Added to the local brightness (grey levels), so that noise in the dark does not count as paint.
_DARK = 10.0


def painted_share(
    view: BirdsEye, image: Image, shape: FloatArray, parameters: Parameters
) -> FloatArray:
    """The share (M,) of each line that is painted, over its first metres in view; NaN where too
    little of it is in view.

    - image: (H, W, 3), blue green red
    - shape: (M, 4) the lines, as in FrameLines
    """
    reach_m, width_m = number(parameters, "paint_reach_m"), number(parameters, "paint_width_m")
    aside = round((reach_m + width_m) / view.across_m) + 1
    across = np.arange(-aside, aside + 1)
    is_near = np.abs(across) * view.across_m <= reach_m + 1e-9
    away = (np.abs(across) * view.across_m) > reach_m + view.across_m
    sides = away & (across < 0), away & (across > 0)
    wide = 2 * max(round(width_m / view.across_m / 2), 1) + 1
    strip = np.ones((1, wide), dtype=np.uint8)
    shares = np.full(len(shape), np.nan)
    for k, line in enumerate(shape):
        rows, columns = _in_view(view, line, aside, number(parameters, "paint_length_m"))
        if len(rows) * view.along_m < number(parameters, "least_length_m"):
            continue
        uv = view.map_uv[0][rows[:, None], columns[:, None] + across]
        seen = image[uv[..., 1], uv[..., 0]].max(axis=2)
        local = seen.mean(axis=1) + _DARK
        narrow = cv2.morphologyEx(seen, cv2.MORPH_TOPHAT, strip)
        bright = narrow[:, is_near].max(axis=1) / local
        beside = [narrow[:, is_side].max(axis=1) / local for is_side in sides]
        noise = np.median(np.minimum(*beside))
        least = max(
            number(parameters, "least_paint"),
            number(parameters, "paint_share") * np.percentile(bright, 90),
            number(parameters, "paint_over_noise") * noise,
        )
        shares[k] = (bright > least).mean()
    return shares


def _in_view(
    view: BirdsEye, line: FloatArray, aside: int, length_m: float
) -> tuple[IntArray, IntArray]:
    """The rows of the view that show the first metres of a line in the picture, and the line's
    columns in these rows."""
    x = view.x_m
    y = line[0] + x * (line[1] + x * (line[2] / 2 + x * line[3] / 6))
    columns = np.floor((y - view.y_m[0]) / view.across_m + 0.5).astype(np.int64)
    inside = (columns >= aside) & (columns < len(view.y_m) - aside)
    rows = np.flatnonzero(inside)
    # The edges of the strip must be in the picture as well: outside is not dark road.
    ends = view.valid[rows, columns[rows] - aside] & view.valid[rows, columns[rows] + aside]
    rows = rows[ends]
    if len(rows):
        rows = rows[x[rows] <= x[rows[-1]] + length_m]
    return rows, columns[rows]
