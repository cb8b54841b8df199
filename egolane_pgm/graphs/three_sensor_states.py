"""The paper's graph with a third sensor state, WORN, between OK and BAD.

The output of a WORN sensor still depends on the lane, with a larger standard deviation than that
of an OK one; the output of a BAD sensor is uniform, as in the paper. A sensor that leaves a state
goes to either of the other two with equal probability.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import (
    Table,
    dynamics,
    lane_normals,
    previous,
    prior,
    sticky,
    uniform,
    within,
)
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = {"SensorState": ("OK", "WORN", "BAD"), "WOR": ("OK", "BAD")}
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "sigma2_worn",
        "sigma",
        1.0,
        "standard deviation of the detector output when the sensor is WORN, lanes",
    ),
    Parameter("p_worn", "probability", 0.9, "P(SensorState WORN at t+1 | WORN at t)"),
    Parameter("p3_worn", "probability", 0.5, "P(WOR OK | SensorState WORN)"),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, each table of SensorState with a row for WORN."""
    p1, p2, p3, p4, p_worn, p3_worn = (
        number(parameters, name) for name in ("p1", "p2", "p3", "p4", "p_worn", "p3_worn")
    )
    moves, ok, worn = (
        lane_normals(number(parameters, name), n_lanes)
        for name in ("sigma1", "sigma2", "sigma2_worn")
    )
    return [
        *prior("Lane", uniform(n_lanes)),
        *prior("SensorState", uniform(3)),
        *dynamics("Lane", [previous("Lane")], moves),
        *dynamics("SensorState", [previous("SensorState")], sticky(p1, p_worn, p2)),
        *within(
            "DetectorOutput",
            ["SensorState", "Lane"],
            np.stack([ok, worn, uniform(n_lanes, n_lanes)]),
        ),
        *within("WOR", ["SensorState"], [[p3, 1 - p3], [p3_worn, 1 - p3_worn], [1 - p4, p4]]),
    ]
