"""An own graph: the sensor is BAD for longer the further the car is from the road's left edge."""

import numpy as np

from egolane_pgm.graphs.cpds import (
    binary,
    declare,
    dynamics,
    lane_normals,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.parameters import Parameter

HIDDEN = ("Lane", "SensorState")
OBSERVED = ("DetectorOutput", "WOR")
PARAMETERS = (
    Parameter("sigma1", "sigma", 0.35, "standard deviation of the lane dynamics, lanes"),
    Parameter("sigma2", "sigma", 0.5, "standard deviation of the detector output, lanes"),
    Parameter("recovery", "probability", 0.2, "P(BAD -> OK) in the leftmost lane"),
)


def build(n_lanes, parameters):
    lane = lane_normals(parameters["sigma1"], n_lanes)
    detector = lane_normals(parameters["sigma2"], n_lanes)
    recovery = parameters["recovery"] / np.arange(1, n_lanes + 1)
    sensor = np.stack([binary(0.95, 1 - r) for r in recovery])
    return declare(
        [
            *prior("Lane", uniform(n_lanes)),
            *prior("SensorState", uniform(2)),
            *dynamics("Lane", [previous("Lane")], lane),
            *dynamics("SensorState", [previous("Lane"), previous("SensorState")], sensor),
            *within(
                "DetectorOutput",
                ["Lane", "SensorState"],
                np.stack([detector, uniform(n_lanes, n_lanes)], axis=1),
            ),
            *within("WOR", ["SensorState"], binary(0.7, 0.7)),
        ],
        OBSERVED,
    )
