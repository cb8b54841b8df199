"""The paper's graph with a sensor that may be biased for a while: it then reports a lane further
LEFT or RIGHT, for example because the detector takes an exit lane or a barrier for the road's edge.

WOR has the same table for a biased sensor as for a working one, so it separates both only from BAD
one. A sensor that leaves a state goes to each of the other three with equal probability.
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
VALUES = {"SensorState": ("OK", "LEFT", "RIGHT", "BAD"), "WOR": ("OK", "BAD")}
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "p_biased",
        "probability",
        0.95,
        "P(SensorState LEFT at t+1 | LEFT at t), and the same for RIGHT",
    ),
    Parameter("shift", "positive", 1.0, "error of a biased output, lanes", search=(0.5, 2.0)),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, each table of SensorState with rows for LEFT and RIGHT."""
    p1, p2, p3, p4, p_biased, shift = (
        number(parameters, name) for name in ("p1", "p2", "p3", "p4", "p_biased", "shift")
    )
    sigma1, sigma2 = number(parameters, "sigma1"), number(parameters, "sigma2")
    outputs = [lane_normals(sigma2, n_lanes, by) for by in (0.0, -shift, shift)]
    working = [p3, 1 - p3]
    return [
        *prior("Lane", uniform(n_lanes)),
        *prior("SensorState", uniform(4)),
        *dynamics("Lane", [previous("Lane")], lane_normals(sigma1, n_lanes)),
        *dynamics("SensorState", [previous("SensorState")], sticky(p1, p_biased, p_biased, p2)),
        *within(
            "DetectorOutput",
            ["SensorState", "Lane"],
            np.stack([*outputs, uniform(n_lanes, n_lanes)]),
        ),
        *within("WOR", ["SensorState"], [working, working, working, [1 - p4, p4]]),
    ]
