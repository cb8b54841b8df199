"""The paper's graph with a sensor that may be biased for a while: its output is that of a lane
further LEFT or RIGHT, as when an exit lane or a barrier is taken for the road's edge.

A biased sensor looks like one that works: WOR tells it from a BAD one only. A state is left for
each of the other three alike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior, uniform, within
from egolane_pgm.graphs.shared_parameters import f_table, number, sticky
from egolane_pgm.parameters import Parameter, Parameters

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = {"SensorState": ("OK", "LEFT", "RIGHT", "BAD")}
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "p_biased",
        "probability",
        0.95,
        "P(SensorState LEFT at t+1 | LEFT at t), and the same for RIGHT",
        search=(0.0, 1.0),
    ),
    Parameter(
        "shift", "positive", 1.0, "by how far a biased output is off, lanes", search=(0.5, 2.0)
    ),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, each table of SensorState with rows for LEFT and RIGHT."""
    p1, p2, p3, p4, p_biased, shift = (
        number(parameters[name]) for name in ("p1", "p2", "p3", "p4", "p_biased", "shift")
    )
    outputs = [f_table("sigma2", n_lanes, parameters, by) for by in (0.0, -shift, shift)]
    working = [p3, 1 - p3]
    return [
        *prior("Lane", uniform(n_lanes)),
        *prior("SensorState", uniform(4)),
        *dynamics("Lane", [previous("Lane")], f_table("sigma1", n_lanes, parameters)),
        *dynamics("SensorState", [previous("SensorState")], sticky(p1, p_biased, p_biased, p2)),
        *within(
            "DetectorOutput",
            ["SensorState", "Lane"],
            np.stack([*outputs, uniform(n_lanes, n_lanes)]),
        ),
        *within("WOR", ["SensorState"], [working, working, working, [1 - p4, p4]]),
    ]


def build(n_lanes: int, parameters: Parameters) -> DynamicBayesianNetwork:
    """The network, declared."""
    return declare(tables(n_lanes, parameters), OBSERVED)
