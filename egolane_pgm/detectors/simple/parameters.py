"""The constants of the single-frame line finder, each with what it means.

The defaults were chosen on the first half of a drive on a worn concrete motorway with heavy
traffic (the first 55 stills of `tusimple_frames`).
"""

from __future__ import annotations

from egolane_pgm.types import Parameter, Parameters

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

PARAMETERS = _VIEW + _MARKINGS + _CONTOURS + _FIT


def number(parameters: Parameters, name: str) -> float:
    """The value of a parameter that is one number."""
    value = parameters[name]
    assert isinstance(value, (int, float))
    return float(value)
