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
    # The bird's-eye view.
    Parameter("x_min_m", "positive", 4.5, "near edge of the bird's-eye view, metres ahead"),
    Parameter("x_max_m", "positive", 35.0, "far edge of the bird's-eye view, metres ahead"),
    Parameter("straight_to_m", "positive", 25.0, "the same for straight lines, as roads bend"),
    Parameter("side_m", "positive", 9.0, "half-width of the bird's-eye view, metres"),
    Parameter("along_m", "positive", 0.1, "metres per pixel of the bird's-eye view, along"),
    Parameter("across_m", "positive", 0.05, "metres per pixel of the bird's-eye view, across"),
    # What stands on the road.
    Parameter(
        "shadow_share",
        "probability",
        0.4,
        "brightness under a vehicle, at most, over that of the road before it; nothing is looked"
        " for behind a shadow as dark and as wide as a vehicle's (0: vehicles are not looked for)",
    ),
    # Marking.
    Parameter(
        "streak_width",
        "probability",
        0.0025,
        "width of the widest streak of rain, as a share of the picture's; in a picture full of"
        " them, all that is as thin is taken out (0: rain is not looked for)",
        highest=0.1,
    ),
    Parameter(
        "marking_width_m",
        "positive",
        0.25,
        "width of the widest strip that counts as marking, metres",
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
        "side of the patch over which brightness and contrast are averaged, metres",
        highest=100,
    ),
    Parameter("brightness_floor", "non_negative", 40.0, "added to the local brightness (0 to 255)"),
    Parameter("least_contrast", "positive", 0.02, "least contrast of marking over brightness"),
    Parameter(
        "blurred_contrast",
        "positive",
        0.0125,
        "the same where the whole picture has little contrast, as when it is blurred or dim",
    ),
    Parameter("least_rise", "non_negative", 4.0, "the same over the mean contrast around"),
    # Its contours.
    Parameter(
        "least_area_m2", "non_negative", 0.04, "area of the smallest contour kept, square metres"
    ),
    Parameter("most_slope", "positive", 0.35, "steepest contour across the road that is kept, m/m"),
    # The lines through them.
    Parameter("lines", "integer", 8, "most lines per frame", lowest=1),
    Parameter(
        "curve",
        "choice",
        "clothoid",
        "what is fitted: straight lines, parabolas (one curvature), or clothoids (a curvature that"
        " changes at a constant rate)",
        choices=tuple(CURVES),
    ),
    Parameter(
        "reach_m",
        "positive",
        0.125,
        "half-width of the strip that a line covers, metres",
        highest=10,
    ),
    Parameter("apart_m", "positive", 2.2, "least distance between lines, metres"),
    Parameter("stripe_m", "positive", 0.1, "width of a marking that counts in full, metres"),
    Parameter(
        "lane_width_m",
        "positive",
        "auto",
        "usual distance of neighbouring lines, metres; auto: the width that the camera was"
        " calibrated with, 3.66 where it names none",
        choices=("auto",),
    ),
    Parameter("lane_width_sd", "sigma", 0.2, "standard deviation of that distance, metres"),
    Parameter("neighbour_bonus", "non_negative", 0.5, "score that a line lends to its neighbours"),
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
        " once as many of its detections go beyond `valid_share`. Both take k frames if no"
        " detection is missed. If every fifth is, `paper` never comes to it and `share` takes 17"
        " frames; if every third is, 35. A line that is seen in half of the frames or fewer does"
        " not become valid but by chance",
        choices=("share", "paper"),
    ),
    Parameter(
        "valid_share",
        "probability",
        0.55,
        "the share of frames that `share` is about: a detection counts one, a miss takes away share"
        " / (1 - share), though never more than there is, and k are needed (Page's test of 1954"
        " for a rate above this one)",
    ),
    Parameter(
        "valid_until",
        "probability",
        0.5,
        "a valid line stays so until its LRI is below this share of k",
    ),
    Parameter(
        "die_after",
        "integer",
        10,
        "a line that was valid once is dropped after this many frames in a row without detection",
        lowest=1,
    ),
    Parameter("new_die_after", "integer", 3, "the same for a line that was never valid", lowest=1),
    Parameter("gate_m", "positive", 1.0, "largest distance of a line from its prediction"),
    Parameter("gate_sigmas", "positive", 4.0, "the same on average, in standard deviations"),
    Parameter("tracks_apart_m", "positive", 1.0, "of two lines nearer than this one is dropped"),
    Parameter(
        "least_lane_m",
        "positive",
        2.8,
        "a line beyond another, seen from the car, and nearer to it than this bounds no lane"
        " (the foot of a barrier, a kerb) and is dropped",
    ),
    Parameter("farthest_m", "positive", 14.0, "a line farther to the side than this is dropped"),
    Parameter(
        "offset_walk_m",
        "positive",
        0.06,
        "standard deviation of a line's own change of offset per frame",
        highest=10,
    ),
    Parameter(
        "shift_gain",
        "probability",
        0.6,
        "share of the matched lines' common motion that moves every line (the car's motion)",
    ),
    Parameter(
        "motion_gain",
        "probability",
        0.4,
        "share of it that enters the steady motion, with which lines are predicted",
    ),
    Parameter(
        "vote_frames",
        "integer",
        20,
        "number of last detections that vote on continuous or dashed",
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
        "continuous_share",
        "probability",
        0.5,
        "a line is continuous if more than this share of its votes says so",
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
