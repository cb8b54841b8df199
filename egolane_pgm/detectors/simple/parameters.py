"""The constants of the single-frame line finder, each with what it means.

The defaults were chosen on the first half of a drive on a worn concrete motorway with heavy
traffic (the first 55 stills of `tusimple_frames`).
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter

_VIEW = (
    Parameter("x_min_m", "positive", 4.5, "nearest road looked at, metres ahead", highest=1000),
    Parameter("x_max_m", "positive", 35.0, "farthest road looked at, metres ahead", highest=1000),
    Parameter("straight_to_m", "positive", 25.0, "but straight lines only up to here: roads bend"),
    Parameter("side_m", "positive", 9.0, "how far to either side is looked, metres", highest=100),
    Parameter(
        "along_m",
        "positive",
        0.1,
        "metres per pixel of the bird's-eye view, along",
        lowest=0.001,
        highest=10,
    ),
    Parameter(
        "across_m",
        "positive",
        0.05,
        "metres per pixel of the bird's-eye view, across",
        lowest=0.001,
        highest=10,
    ),
)

_MARKINGS = (
    Parameter(
        "marking_width_m",
        "positive",
        0.25,
        "strips wider than this are no marking, metres",
        highest=10,
    ),
    Parameter(
        "smooth_along_m",
        "positive",
        0.7,
        "length over which contrast is averaged, metres",
        highest=100,
    ),
    Parameter(
        "around_m",
        "positive",
        4.0,
        "size of the patch that says what is usual, metres",
        highest=100,
    ),
    Parameter("brightness_floor", "non_negative", 40.0, "added to the local brightness (0 to 255)"),
    Parameter("least_contrast", "positive", 0.02, "share of local brightness that a marking adds"),
    Parameter("least_rise", "non_negative", 4.0, "times the mean contrast around that it has"),
)

_CONTOURS = (
    Parameter("least_area_m2", "non_negative", 0.04, "smaller contours are dropped, square metres"),
    Parameter("most_slope", "positive", 0.35, "contours further across the road are dropped, m/m"),
)

_FIT = (
    Parameter("lines", "integer", 8, "most lines per frame", lowest=1),
    Parameter(
        "curve",
        "choice",
        "clothoid",
        "what is fitted: straight lines or clothoids",
        choices=("line", "clothoid"),
    ),
    Parameter("most_heading", "positive", 0.15, "largest heading of the road, m/m"),
    Parameter(
        "heading_sd", "sigma", 0.03, "usual heading of the road, m/m", lowest=1e-6, highest=10
    ),
    Parameter("most_curvature", "positive", 0.003, "largest curvature of the road, 1/m"),
    Parameter(
        "curvature_sd", "sigma", 0.001, "usual curvature of the road, 1/m", lowest=1e-9, highest=10
    ),
    Parameter("most_squeeze", "positive", 0.008, "largest effect of a wrong pitch on widths, 1/m"),
    Parameter(
        "squeeze_sd",
        "sigma",
        0.004,
        "usual effect of pitching: radians over height, 1/m",
        lowest=1e-9,
        highest=10,
    ),
    Parameter(
        "prior_share",
        "positive",
        0.3,
        "the same three given the frame before, times this",
        lowest=1e-3,
        highest=1000,
    ),
    Parameter("slope_sd", "sigma", 0.05, "contours of a line differ so much in direction, m/m"),
    Parameter(
        "reach_m", "positive", 0.125, "a line covers what is so near to it, metres", highest=10
    ),
    Parameter("apart_m", "positive", 2.2, "lines are at least so far apart, metres"),
    Parameter("stripe_m", "positive", 0.1, "width of a marking that counts as fully there, metres"),
    Parameter("lane_width_m", "positive", 3.66, "usual distance of neighbouring lines, metres"),
    Parameter("lane_width_sd", "sigma", 0.2, "standard deviation of that distance, metres"),
    Parameter("neighbour_bonus", "non_negative", 0.5, "score that a line lends to its neighbours"),
    Parameter("least_score", "non_negative", 0.12, "lines that score less are dropped"),
)

#: What finding the lines of one picture depends on.
FINDING = _VIEW + _MARKINGS + _CONTOURS + _FIT


#: What following lines from picture to picture depends on.
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
        "valid_until",
        "probability",
        0.5,
        "a line becomes valid at LRI k and stays so until its LRI is below this share of k",
    ),
    Parameter(
        "die_after",
        "integer",
        10,
        "a line that once was valid is given up when not detected in so many frames running",
        lowest=1,
    ),
    Parameter("new_die_after", "integer", 3, "the same for a line that never was valid", lowest=1),
    Parameter("gate_m", "positive", 1.0, "a line moves at most so far from where it is predicted"),
    Parameter(
        "gate_sigmas", "positive", 4.0, "and at most so many standard deviations, on the average"
    ),
    Parameter("tracks_apart_m", "positive", 1.0, "of two lines nearer than this one is given up"),
    Parameter(
        "least_lane_m",
        "positive",
        2.8,
        "a line beyond another, seen from the car, and nearer to it than this bounds no lane"
        " (the foot of a barrier, a kerb) and is given up",
    ),
    Parameter("farthest_m", "positive", 14.0, "a line farther to the side than this is given up"),
    Parameter(
        "track_near_m",
        "positive",
        6.0,
        "lines are compared from so far ahead of the camera",
        highest=1000,
    ),
    Parameter("track_far_m", "positive", 30.0, "up to so far ahead", highest=1000),
    Parameter(
        "measure_sigma_m",
        "positive",
        0.12,
        "standard deviation of a found line's place, near",
        lowest=1e-3,
        highest=100,
    ),
    Parameter(
        "measure_sigma_far_m",
        "positive",
        0.35,
        "the same at the far end, growing in between",
        lowest=1e-3,
        highest=100,
    ),
    Parameter(
        "offset_walk_m",
        "positive",
        0.06,
        "standard deviation of a line's own motion per frame",
        highest=10,
    ),
    Parameter("heading_walk", "positive", 0.004, "the same of its heading, radians", highest=1),
    Parameter("curvature_walk", "positive", 2e-4, "the same of its curvature, 1/m", highest=0.1),
    Parameter(
        "rate_walk", "positive", 4e-6, "the same of the curvature's change, 1/m^2", highest=0.1
    ),
    Parameter(
        "shift_gain",
        "probability",
        0.6,
        "the share of what all matched lines have moved alike that is taken for the car's motion"
        " and moves every line",
    ),
    Parameter(
        "motion_gain",
        "probability",
        0.4,
        "the share of that which goes into the car's steady motion, by which lines are predicted",
    ),
    Parameter(
        "vote_frames",
        "integer",
        20,
        "detections of a line that vote on continuous or dashed",
        lowest=1,
        highest=10_000,
    ),
    Parameter(
        "continuous_cover",
        "probability",
        0.55,
        "a detection votes for continuous where at least this share of the line is painted",
    ),
    Parameter(
        "continuous_share",
        "probability",
        0.5,
        "a line is continuous where more than this share of its votes says so",
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
