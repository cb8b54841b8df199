"""The paper's graph with failures that last neither very short nor very long.

In the paper a failure ends in each frame with probability 1 - p2, and one frame is its most
probable duration. Here it passes through `failure_phases` phases, each of which ends with the same
probability (the method of stages; Cox and Miller 1965). Its mean duration is 1 / (1 - p2) frames as
in the paper, and its standard deviation shrinks about with the root of the number of phases.
SensorState is a function of the hidden Phase: it is BAD in each of them. With one phase this is the
graph `sensor_failure`.

A failure lasts at least `failure_phases` frames, so a smaller mean duration counts as that.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, dynamics, previous, prior, within
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = (*sensor_failure.HIDDEN, "Phase")
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "failure_phases",
        "integer",
        3,
        "phases that a failure passes through, in order",
        lowest=1,
        highest=100,
    ),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with Table `tab:cptsensor` for Phase: 0 is OK, 1 to k a failure."""
    p1, p2 = number(parameters, "p1"), number(parameters, "p2")
    k = int(number(parameters, "failure_phases"))
    end = min(1.0, k * (1 - p2))
    moves = np.diag([p1, *[1 - end] * k])
    moves[0, 1] = 1 - p1
    for phase in range(1, k + 1):
        moves[phase, (phase + 1) % (k + 1)] += end
    is_bad = np.array([[1.0, 0.0], *[[0.0, 1.0]] * k])
    return [
        *(t for t in sensor_failure.tables(n_lanes, parameters) if t.node[0] != "SensorState"),
        *prior("Phase", [0.5, *[0.5 / k] * k]),
        *dynamics("Phase", [previous("Phase")], moves),
        *within("SensorState", ["Phase"], is_bad),
    ]
