"""The constants of following lines over time, each with what it means.

What tells continuous from dashed was chosen on the first half of a drive on a worn concrete
motorway (the first 55 stills of `tusimple_frames`); the rest by reason, not by search.
"""

from __future__ import annotations

from egolane_pgm.types import Parameter

PARAMETERS = (
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
