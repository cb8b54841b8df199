"""The parameters of the evidence rule `line_geometry`, with their generic values."""

from __future__ import annotations

from egolane_pgm.evidence.line_geometry.model import N_CLASSES
from egolane_pgm.graphs.position_in_lane import CELLS, MOTION_BINS
from egolane_pgm.parameters import Parameter

#: The narrowest and the widest lane that can be given. A detector may have other metres than we do,
#: but not by this much.
_NARROWEST_M = 0.01
_WIDEST_M = 1000.0

_OR_FITTED = "; `generic`, or a list that `egolane learn` writes"

PARAMETERS = (
    Parameter(
        "lane_width_m",
        "positive",
        "causal",
        "lane width in the detector's metres: a number, `causal` (estimated, like the semantics of"
        " the detector's flags and LRI, from the frames so far) or `auto` (from the whole"
        " recording; the default of the filter `smoothed`)",
        choices=("auto", "causal"),
        smoothed="auto",
        lowest=_NARROWEST_M,
        highest=_WIDEST_M,
    ),
    Parameter(
        "fallback_width_m",
        "positive",
        3.5,
        "expected lane width before there are lines, in the detector's metres",
        search=None,
        lowest=_NARROWEST_M,
        highest=_WIDEST_M,
    ),
    Parameter(
        "width_wanders",
        "non_negative",
        0.0,
        "largest relative deviation of the lane width from its estimate for the whole recording,"
        " because pitch and hills change the scale; far lines then count as exactly as near ones."
        " With `causal` the width follows the lines",
        search=None,
        smoothed=0.07,
        highest=0.5,
    ),
    Parameter(
        "alpha",
        "non_negative",
        0.035,
        "weight of the evidence on the lane in a tenth of a second. Half of it with the filter"
        " `smoothed`, where an error of ten seconds counts before and after them",
        search=(0.01, 0.2),
        smoothed=0.0175,
    ),
    Parameter(
        "beta",
        "non_negative",
        0.15,
        "weight of the evidence on the place inside the lane in a tenth of a second",
        search=(0.05, 1.0),
    ),
    Parameter(
        "rates",
        "non_negative",
        "generic",
        "expected lines from each lane: a row of n + 3 per lane, the n + 1 lines of the road, then"
        " left and right shoulder" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n, n + 3),
    ),
    Parameter(
        "class_shares",
        "probability",
        "generic",
        "shares of the line classes: a row of four per line" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n + 3, N_CLASSES),
    ),
    Parameter(
        "sigmas_m",
        "sigma",
        "generic",
        "standard deviation of each line about its place, metres of a lane of 3.5 m" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (n + 3,),
    ),
    Parameter(
        "shoulders",
        "positive",
        "generic",
        "distance of the left and right shoulder line from the road, lane widths" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (2,),
    ),
    Parameter(
        "clutter",
        "non_negative",
        "generic",
        "false lines per metre, of each class" + _OR_FITTED,
        choices=("generic",),
        shape=lambda n: (N_CLASSES,),
    ),
    CELLS,
    MOTION_BINS,
)
