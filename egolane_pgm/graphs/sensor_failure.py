"""The paper's graph (Figure `fig:model`, equation `eq:HMM`).

Lane and SensorState persist from frame to frame. Both are parents of DetectorOutput, and
SensorState is the parent of WOR. SensorState and WOR have the values OK (0) and BAD (1).
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    builder,
    dynamics,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.graphs.shared_parameters import (
    LANE_WIDTHS,
    NORMAL,
    P1,
    P2,
    P3,
    P4,
    SIGMA1,
    SIGMA2,
    f_table,
)
from egolane_pgm.parameters import Parameters, number

HIDDEN = ("Lane", "SensorState")
OBSERVED = ("DetectorOutput", "WOR")
VALUES = {"SensorState": ("OK", "BAD"), "WOR": ("OK", "BAD")}
PARAMETERS = (SIGMA1, SIGMA2, P1, P2, P3, P4, NORMAL, LANE_WIDTHS)


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
    detector_ok = f_table("sigma2", n_lanes, parameters)
    detector_bad = uniform(n_lanes, n_lanes)
    return [
        *prior("Lane", uniform(n_lanes)),
        *prior("SensorState", uniform(2)),
        *dynamics("Lane", [previous("Lane")], f_table("sigma1", n_lanes, parameters)),
        *dynamics("SensorState", [previous("SensorState")], binary(p1, p2)),
        *within("DetectorOutput", ["SensorState", "Lane"], np.stack([detector_ok, detector_bad])),
    ]


build = builder(tables, OBSERVED)
