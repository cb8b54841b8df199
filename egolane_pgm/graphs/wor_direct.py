"""A graph without SensorState, in which WOR takes its place: WOR determines for each frame alone
whether the detector output can be trusted, and the sensor has no memory.

WOR is an observed parent of DetectorOutput. It is known from its evidence and its prior `p_wor`.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs.cpds import (
    Table,
    dynamics,
    lane_normals,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.graphs.sensor_failure import SIGMA1, SIGMA2
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = ("Lane",)
OBSERVED = ("DetectorOutput", "WOR")
VALUES = {"WOR": ("OK", "BAD")}
PARAMETERS = (
    SIGMA1,
    SIGMA2,
    Parameter("p_wor", "probability", 0.5, "P(WOR OK) in any frame"),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """Tables `tab:cptlane` and `tab:cptdetlane`; WOR selects the rows of the latter."""
    sigma1, sigma2, p_wor = (number(parameters, name) for name in ("sigma1", "sigma2", "p_wor"))
    outputs = [lane_normals(sigma2, n_lanes), uniform(n_lanes, n_lanes)]
    return [
        *prior("Lane", uniform(n_lanes)),
        *dynamics("Lane", [previous("Lane")], lane_normals(sigma1, n_lanes)),
        *within("WOR", [], [p_wor, 1 - p_wor]),
        *within("DetectorOutput", ["WOR", "Lane"], np.stack(outputs)),
    ]
