"""The parameters of the paper's model (equation `eq:HMM`) that several graphs declare, and the
table F of a normal made from them."""

from __future__ import annotations

from egolane_pgm.graphs.cpds import lane_normals
from egolane_pgm.parameters import Parameter, Parameters, number, per_lane
from egolane_pgm.types import FloatArray

SIGMA1 = Parameter(
    "sigma1", "sigma", 0.4, "standard deviation of the lane dynamics, lanes; Table `tab:cptlane`"
)
SIGMA2 = Parameter(
    "sigma2",
    "sigma",
    0.5,
    "standard deviation of the detector output when the sensor works, lanes; Table"
    " `tab:cptdetlane`",
)
P1 = Parameter(
    "p1", "probability", 0.9, "P(SensorState OK at t+1 | OK at t); Table `tab:cptsensor`"
)
P2 = Parameter(
    "p2", "probability", 0.9, "P(SensorState BAD at t+1 | BAD at t); Table `tab:cptsensor`"
)
P3 = Parameter("p3", "probability", 0.6, "P(WOR OK | SensorState OK); Table `tab:cptri`")
P4 = Parameter("p4", "probability", 0.6, "P(WOR BAD | SensorState BAD); Table `tab:cptri`")
WOR_LEVELS = Parameter(
    "wor_levels", "integer", 3, "values of WOR, the most reliable one first", lowest=2, highest=100
)
NORMAL = Parameter(
    "normal",
    "choice",
    "density",
    "how F makes a table of a normal: `density` at the lane centres (the authors'), `integral`"
    " across each lane (the text)",
    choices=("density", "integral"),
)
LANE_WIDTHS = Parameter(
    "lane_widths",
    "positive",
    1.0,
    "width of each lane in units of the nominal lane (one number, or one per lane)",
    search=None,
    per_lane=True,
)


def f_table(sigma: str, n_lanes: int, parameters: Parameters, shift: float = 0.0) -> FloatArray:
    """F(N(lane + shift, sigma^2)) for each lane: (n, n), a row per lane.

    - sigma: name of the parameter that holds the standard deviation
    - shift: nominal lanes, positive to the right
    """
    normal, widths = str(parameters["normal"]), per_lane(parameters, "lane_widths", n_lanes)
    return lane_normals(number(parameters, sigma), n_lanes, normal, widths, shift)
