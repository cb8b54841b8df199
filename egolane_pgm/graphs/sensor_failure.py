"""The paper's graph (Figure `fig:model`, equation `eq:HMM`).

Lane and SensorState persist from frame to frame. Both are parents of DetectorOutput, and
SensorState is the parent of WOR. SensorState and WOR have the values OK (0) and BAD (1).
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    dynamics,
    lane_normals,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.parameters import Parameter, Parameters, number

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

HIDDEN = ("Lane", "SensorState")
OBSERVED = ("DetectorOutput", "WOR")
VALUES = {"SensorState": ("OK", "BAD"), "WOR": ("OK", "BAD")}
PARAMETERS = (SIGMA1, SIGMA2, P1, P2, P3, P4)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """The paper's Tables `tab:cptlane`, `tab:cptsensor`, `tab:cptdetlane` and `tab:cptri`."""
    p3, p4 = number(parameters, "p3"), number(parameters, "p4")
    return [
        *tables_without_wor(n_lanes, parameters),
        *within("WOR", ["SensorState"], binary(p3, p4)),
    ]


def tables_without_wor(n_lanes: int, parameters: Parameters) -> list[Table]:
    """Tables `tab:cptlane`, `tab:cptsensor` and `tab:cptdetlane`."""
    p1, p2 = number(parameters, "p1"), number(parameters, "p2")
    sigma1, sigma2 = number(parameters, "sigma1"), number(parameters, "sigma2")
    outputs = [lane_normals(sigma2, n_lanes), uniform(n_lanes, n_lanes)]
    return [
        *prior("Lane", uniform(n_lanes)),
        *prior("SensorState", uniform(2)),
        *dynamics("Lane", [previous("Lane")], lane_normals(sigma1, n_lanes)),
        *dynamics("SensorState", [previous("SensorState")], binary(p1, p2)),
        *within("DetectorOutput", ["SensorState", "Lane"], np.stack(outputs)),
    ]
