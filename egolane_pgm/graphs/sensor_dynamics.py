"""The paper's graph in which the lane dynamics depend on SensorState in the same slice: during a
lane change the lines are harder to detect, so that lane changes and sensor failures coincide.

With `sigma1_bad` equal to `sigma1` this is the graph `sensor_failure`.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, dynamics, lane_normals, previous, prior, uniform
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "sigma1_bad",
        "sigma",
        0.6,
        "standard deviation of the lane dynamics into a frame with a BAD sensor, lanes (`sigma1`:"
        " with an OK one)",
    ),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with one Table `tab:cptlane` for each sensor state."""
    others = [t for t in sensor_failure.tables(n_lanes, parameters) if t.node[0] != "Lane"]
    moves = [lane_normals(number(parameters, p), n_lanes) for p in ("sigma1", "sigma1_bad")]
    return [
        *others,
        *prior("Lane", uniform(2, n_lanes), ["SensorState"]),
        *dynamics("Lane", ["SensorState", previous("Lane")], np.stack(moves)),
    ]
