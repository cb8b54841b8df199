"""The parameters of the line finder and of the tracking.

The defaults of the line finder were chosen on the first half of a drive on a worn concrete motorway
with heavy traffic (the first 55 stills of `tusimple_frames`).
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter

#: How many of a shape's four values (offset, heading, curvature, its rate) each curve has.
CURVES = {"line": 2, "parabola": 3, "clothoid": 4}

#: The parameters of the line finder, which sees one picture.
FINDING = (
    Parameter("x_min_m", "positive", 4.5, "near edge of the bird's-eye view, metres ahead"),
    Parameter("x_max_m", "positive", 35.0, "far edge of the bird's-eye view, metres ahead"),
    Parameter("side_m", "positive", 9.0, "half-width of the bird's-eye view, metres"),
    Parameter(
        "shadow_share",
        "probability",
        0.4,
        "brightness under a vehicle, at most, over that of the road before it; nothing is looked"
        " for behind a shadow as dark and as wide as a vehicle's (0: vehicles are not looked for)",
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
        "what is fitted: straight lines, parabolas (one curvature), or clothoids (a curvature that"
        " changes at a constant rate)",
        choices=tuple(CURVES),
    ),
    Parameter(
        "lane_width_m",
        "positive",
        "auto",
        "usual distance of neighbouring lines, metres; auto: the width that the camera was"
        " calibrated with, 3.66 where it names none",
        choices=("auto",),
    ),
    Parameter("least_score", "non_negative", 0.12, "least score of a line that is kept"),
)

#: The parameters of the tracking.
TRACKING = (
    Parameter(
        "lri_frames",
        "integer",
        10,
        "k: the LRI of a line is how many of the last k frames it was detected in",
        lowest=1,
        highest=10_000,
    ),
    Parameter(
        "valid_when",
        "choice",
        "share",
        "when a line becomes valid: `paper`, at LRI k, which is k detections in a row; `share`,"
        " once that many of its detections exceed a share of 0.55 of the frames (Page's test of"
        " 1954). Both take k frames if no detection is missed. If every fifth is, `paper` never"
        " comes to it and `share` takes 17 frames; if every third is, 35",
        choices=("share", "paper"),
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
        "hide_all",
        "lines beyond a valid continuous one, the edge of most roads: `hide_all` (barriers, kerbs,"
        " tracks of tyres), `hide_continuous` ones, or `keep` them (a lane behind such a line)",
        choices=("hide_all", "hide_continuous", "keep"),
    ),
)
