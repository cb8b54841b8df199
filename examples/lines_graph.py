"""The paper's graph with an input: the sensor fails more often the fewer lines are valid."""

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import binary, dynamics, previous, prior, uniform, within
from egolane_pgm.parameters import Parameter

HIDDEN, OBSERVED, VALUES = sensor_failure.HIDDEN, sensor_failure.OBSERVED, sensor_failure.VALUES
INPUTS = ("Lines",)
BOUNDS = {"Lines": (2, 4)}  # three values: 0 or 1, 2 or 3, 4 or more lines
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter("few", "probability", 0.3, "P(SensorState OK at t+1 | OK at t), 0 or 1 lines"),
    Parameter("many", "probability", 0.99, "P(SensorState OK at t+1 | OK at t), 4 or more lines"),
)


def tables(n_lanes, parameters):
    paper = sensor_failure.tables(n_lanes, parameters)
    stays = [parameters[name] for name in ("few", "p1", "many")]
    sensor = np.stack([binary(ok, parameters["p2"]) for ok in stays])
    return [
        *(table for table in paper if table.node[0] != "SensorState"),
        *within("Lines", [], uniform(3)),
        *prior("SensorState", uniform(3, 2), ["Lines"]),
        *dynamics("SensorState", ["Lines", previous("SensorState")], sensor),
    ]
