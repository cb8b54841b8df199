"""The parameters of the line finder and of the tracking.

The defaults of the line finder were chosen on the first half of a drive on a worn concrete motorway
with heavy traffic (the first 55 stills of `tusimple_frames`).
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter

#: Number of non-zero values (offset, heading, curvature, its rate) in a shape, by curve.
CURVES = {"line": 2, "parabola": 3, "clothoid": 4}

#: The parameters of the line finder, which works on single pictures.
FINDING = (
    Parameter("x_min_m", "positive", 4.5, "near edge of the bird's-eye view, metres ahead"),
    Parameter("x_max_m", "positive", 35.0, "far edge of the bird's-eye view, metres ahead"),
    Parameter("side_m", "positive", 9.0, "half-width of the bird's-eye view, metres"),
    Parameter(
        "shadow_share",
        "probability",
        0.4,
        "largest ratio of the brightness under a vehicle to the road before it; no line"
        " is searched behind a shadow as wide as a vehicle's (0: vehicles are not searched)",
    ),
    Parameter(
        "marking_width_m",
        "positive",
        0.25,
        "width of the widest strip that counts as marking, metres",
        highest=10,
    ),
    Parameter(
        "least_rise", "non_negative", 4.0, "least contrast of marking over the mean contrast around"
    ),
    Parameter(
        "curve",
        "choice",
        "clothoid",
        "curve that is fitted: straight lines, parabolas (one curvature), or clothoids (a curvature"
        " that changes at a constant rate)",
        choices=tuple(CURVES),
    ),
    Parameter("least_score", "non_negative", 0.12, "least score of a line that is kept"),
)

#: The parameters of the tracking.
TRACKING = (
    Parameter(
        "lri_frames",
        "integer",
        10,
        "k: the LRI of a line is the number of the last k frames in which it was detected; a new"
        " line becomes valid after k detections, or later if some are missed",
        lowest=1,
        highest=10_000,
    ),
    Parameter(
        "continuous_cover",
        "probability",
        0.55,
        "least painted share of a line for a vote for continuous",
    ),
    Parameter(
        "beyond_edge",
        "choice",
        "hide",
        "lines beyond a valid continuous one, which is the edge of most roads: `hide` them"
        " (barriers, kerbs, tyre tracks), or `keep` them (there is a lane behind such a line)",
        choices=("hide", "keep"),
    ),
)
