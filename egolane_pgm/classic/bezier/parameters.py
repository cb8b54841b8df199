"""The parameters of Aly's detector, named as in its public configuration (`Lanes.conf`):
`lowerQuantile` there is `lower_quantile` here. `LEFT_OUT` has the keys of that file that are no
parameter, and why.

Lengths are pixels of the view (columns across, rows along the road) or of the picture made smaller.
The defaults have twice the resolution of the file in both: a view of 320 x 240 instead of 160 x 120
pixels, and a focal length of 618.8 instead of 309.4 pixels, the one of the camera of the public
pictures; lengths across are therefore twice those of the file. The scores' unit is not known, and
so their thresholds are ours. These and `far_m`, `smooth_sigma`, `ridge_sigma`, `group_threshold`,
`overlap_threshold`, `most_turn_deg`, `theta_max` and `localize_num_line_pixels` were chosen on the
first 55 stills of `tusimple_frames`, where the file's own values find few of the worn lines.
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter


def _switch(name: str, default: str, doc: str) -> Parameter:
    return Parameter(name, "choice", default, doc, choices=("no", "yes"))


_VIEW = (
    Parameter("ipm_width", "integer", 320, "columns of the view", lowest=32, highest=2000),
    Parameter("ipm_height", "integer", 240, "rows of the view", lowest=32, highest=2000),
    Parameter("near_m", "positive", 4.0, "near edge of the view, metres ahead", highest=1000),
    Parameter("far_m", "positive", 20.0, "far edge of the view, metres ahead", highest=1000),
    Parameter("side_m", "positive", 9.0, "half-width of the view, metres", highest=100),
    Parameter(
        "focal_px",
        "positive",
        618.8,
        "pictures are made smaller until their focal length is this, pixels",
        lowest=20,
    ),
)

_RIDGES = (
    Parameter("smooth_taps", "integer", 33, "length of the smoothing along the road", lowest=1),
    Parameter("smooth_sigma", "sigma", 8.0, "its standard deviation, rows", highest=100),
    Parameter("ridge_taps", "integer", 9, "length of the ridge filter across the road", lowest=3),
    Parameter("ridge_sigma", "sigma", 0.8, "its standard deviation, columns", highest=100),
    Parameter(
        "lower_quantile",
        "probability",
        0.975,
        "weaker ridges than this quantile are 0 (.985 for the two lines of the own lane only)",
    ),
    _switch("binarize", "no", "all ridges count alike when lines are looked for"),
)

_GROUPING = (
    Parameter(
        "grouping_type",
        "choice",
        "columns",
        "how first lines are found: sums of columns, or the Hough transform",
        choices=("columns", "hough"),
    ),
    Parameter("detection_threshold", "non_negative", 0.1, "least score of a first line"),
    _switch("smooth_scores", "yes", "smooth the sums of columns"),
    Parameter("score_taps", "integer", 21, "length of that smoothing, columns", lowest=1),
    Parameter("score_sigma", "sigma", 2.0, "its standard deviation, columns", highest=100),
    Parameter("r_min", "non_negative", 20.0, "Hough: smallest distance from the corner, pixels"),
    Parameter("r_max", "positive", 300.0, "Hough: largest distance from the corner, pixels"),
    Parameter("r_step", "positive", 2.0, "Hough: its step", lowest=0.1),
    Parameter("theta_max", "positive", 10.0, "Hough: largest angle, degrees", highest=90),
    Parameter("theta_step", "positive", 1.0, "Hough: its step", lowest=0.1),
    Parameter("group_threshold", "non_negative", 30.0, "lines nearer than this are one, columns"),
    Parameter("overlap_threshold", "probability", 0.5, "boxes that share more than this are one"),
)

_RANSAC = (
    Parameter("seed", "integer", 0, "of the random samples"),
    _switch("ransac_line", "yes", "fit a line in each box"),
    Parameter("ransac_line_num_samples", "integer", 4, "points of a sample", lowest=2),
    Parameter("ransac_line_num_iterations", "integer", 40, "samples", lowest=1, highest=100_000),
    Parameter("ransac_line_num_good_fit", "integer", 10, "fewest points on a line"),
    Parameter("ransac_line_threshold", "positive", 0.4, "farthest point on a line, pixels"),
    Parameter("ransac_line_score_threshold", "non_negative", 0.0, "least score of a line"),
    _switch("ransac_line_binarize", "no", "all ridges count alike in lines"),
    Parameter("ransac_line_window", "non_negative", 30.0, "columns to either side of a first line"),
    Parameter("most_turn_deg", "positive", 5.0, "steepest line across the road", highest=90),
    _switch("ransac_spline", "yes", "fit a Bezier spline near each line"),
    Parameter("ransac_spline_num_samples", "integer", 4, "points of a sample", lowest=4),
    Parameter("ransac_spline_num_iterations", "integer", 40, "samples", lowest=1, highest=100_000),
    Parameter("ransac_spline_score_threshold", "non_negative", 0.0, "least score of a spline"),
    _switch("ransac_spline_binarize", "no", "all ridges count alike in splines"),
    Parameter("ransac_spline_window", "non_negative", 20.0, "columns to either side of a line"),
    Parameter("ransac_spline_step", "probability", 0.1, "step along a spline to its points"),
    Parameter("spline_score_jitter", "integer", 2, "columns beside a spline that it covers"),
    Parameter("spline_score_length_ratio", "non_negative", 1.5, "weight of a spline's length"),
    Parameter("spline_score_angle_ratio", "non_negative", 1.2, "weight of its straightness"),
    Parameter("spline_score_step", "probability", 0.01, "step along a spline that is scored"),
)

_CHECKS = (
    Parameter("merge_theta", "non_negative", 0.1, "of two splines that turn by less, radians,"),
    Parameter("merge_r", "non_negative", 5.0, "and lie nearer, pixels, the worse one is dropped"),
    Parameter("merge_mean_theta", "non_negative", 0.2, "the same for the mean along the splines,"),
    Parameter("merge_mean_r", "non_negative", 10.0, "and its distance, pixels"),
    Parameter("merge_centroid", "non_negative", 15.0, "but only if their middles are so near"),
    Parameter(
        "check_ipm_splines_curveness_threshold",
        "probability",
        0.8,
        "least straightness",
    ),
    Parameter("check_ipm_splines_length_threshold", "non_negative", 30.0, "shortest one, pixels"),
    Parameter(
        "check_ipm_splines_theta_threshold", "positive", 1.22, "most turned one, radians", highest=2
    ),
    Parameter("final_spline_score_threshold", "non_negative", 0.0, "least score of a spline"),
    Parameter("lines", "integer", 4, "most lines per picture", lowest=1, highest=4),
)

_PICTURE = (
    _switch("localize", "yes", "move a spline's points, in the picture, onto the brightest strip"),
    Parameter(
        "localize_num_line_pixels", "integer", 10, "how far to either side, pixels", lowest=1
    ),
    Parameter(
        "localize_angle_threshold", "probability", 0.9, "least cosine between old and new direction"
    ),
    _switch("extend", "yes", "continue a spline at both ends along bright strips"),
    Parameter("extend_line_pixels_tangent", "positive", 10.0, "step of the extension, pixels"),
    Parameter("extend_line_pixels_normal", "integer", 20, "how far to either side", lowest=1),
    Parameter(
        "extend_angle_threshold", "probability", 0.86, "least cosine between one step and the next"
    ),
    Parameter(
        "extend_mean_dir_angle_threshold", "probability", 0.95, "the same to the mean direction"
    ),
    Parameter(
        "extend_cont_threshold", "probability", 0.35, "least contrast, as a share of the spline's"
    ),
    Parameter("extend_to_m", "positive", 28.0, "farthest extension, metres ahead", highest=1000),
)

PARAMETERS = _VIEW + _RIDGES + _GROUPING + _RANSAC + _CHECKS + _PICTURE

_OFF = "off there, and not here"
_ON = "on there, and always here"
_METRES = "near_m, far_m and side_m say it in metres of road, for any camera"
_KERNEL = "smooth_taps, smooth_sigma, ridge_taps and ridge_sigma say it"
_SCORE = "a spline is judged by its score alone"
_UNSAID = "not said what it compares"
_VIEW_TOO = "a spline is continued in the picture only"
_PICTURE_TOO = "a spline is checked in the view only, where angles mean the same for every camera"
_TRACKER = "its tracker is not public; `simple.tracking` takes its place"
_COLOUR = "off there; the red channel, in which yellow is as bright as white, is used instead"

#: The keys of `Lanes.conf` that are no parameter, and why.
LEFT_OUT = {
    "ipmInterpolation": "always bilinear",
    "useGroundPlane": "lines are always brought onto the road by the camera",
    "ransacSplineDegree": "always 3",
    "thetaMin": "minus theta_max",
    **dict.fromkeys(("ipmLeft", "ipmRight", "ipmTop", "ipmBottom", "ipmVpPortion"), _METRES),
    **dict.fromkeys(("lineWidth", "lineHeight", "kernelWidth", "kernelHeight"), _KERNEL),
    **dict.fromkeys(("localMaxima", "group", "ransac", "checkIPMSplines"), _ON),
    **dict.fromkeys(("getEndPoints", "numStrips"), _OFF),
    **dict.fromkeys(("ransacSplineNumGoodFit", "ransacSplineThreshold"), _SCORE),
    **dict.fromkeys(("extendDeviationThreshold", "checkIPMSplinesThetaDiffThreshold"), _UNSAID),
    **dict.fromkeys(("extendRectTop", "extendRectBottom"), "extend_to_m says it in metres"),
    **dict.fromkeys(
        (
            "extendIPMAngleThreshold",
            "extendIPMMeanDirAngleThreshold",
            "extendIPMLinePixelsTangent",
            "extendIPMLinePixelsNormal",
            "extendIPMContThreshold",
            "extendIPMDeviationThreshold",
            "extendIPMRectTop",
            "extendIPMRectBottom",
        ),
        _VIEW_TOO,
    ),
    **dict.fromkeys(
        (
            "checkSplines",
            "checkSplinesCurvenessThreshold",
            "checkSplinesLengthThreshold",
            "checkSplinesThetaDiffThreshold",
            "checkSplinesThetaThreshold",
        ),
        _PICTURE_TOO,
    ),
    **dict.fromkeys(
        (
            "splineTrackingNumAbsentFrames",
            "splineTrackingNumSeenFrames",
            "lineTrackingNumAbsentFrames",
            "lineTrackingNumSeenFrames",
            "mergeSplineThetaThreshold",
            "mergeSplineRThreshold",
            "mergeSplineMeanThetaThreshold",
            "mergeSplineMeanRThreshold",
            "mergeSplineCentroidThreshold",
            "mergeLineThetaThreshold",
            "mergeLineRThreshold",
        ),
        _TRACKER,
    ),
    **dict.fromkeys(
        (
            "checkColor",
            "checkColorWindow",
            "checkColorNumBins",
            "checkColorNumYellowMin",
            "checkColorRGMin",
            "checkColorRGMax",
            "checkColorGBMin",
            "checkColorRBMin",
            "checkColorRBF",
            "checkColorRBFThreshold",
        ),
        _COLOUR,
    ),
    **dict.fromkeys(("ipmWindowClear", "ipmWindowLeft", "ipmWindowRight"), _OFF),
    **dict.fromkeys(("checkLaneWidth", "checkLaneWidthMean", "checkLaneWidthStd"), _OFF),
}
