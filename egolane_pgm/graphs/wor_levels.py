"""The paper's graph in which WOR has `wor_levels` levels, the most reliable one first. The evidence
rule `counting_levels` provides them.

Given the sensor state, the level is binomial: each of `wor_levels` - 1 draws lowers it by one, with
probability 1 - p3 when the sensor is OK and p4 when it is BAD. With two levels this is the graph
`sensor_failure`.
"""

from __future__ import annotations

import math

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, within
from egolane_pgm.graphs.sensor_failure import WOR_LEVELS
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import FloatArray

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = {"SensorState": ("OK", "BAD")}
PARAMETERS = (*sensor_failure.PARAMETERS, WOR_LEVELS)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with a column of Table `tab:cptri` for each level."""
    p3, p4 = number(parameters, "p3"), number(parameters, "p4")
    levels = int(number(parameters, "wor_levels"))
    return [
        *sensor_failure.tables_without_wor(n_lanes, parameters),
        *within("WOR", ["SensorState"], np.stack([binomial(p3, levels), binomial(1 - p4, levels)])),
    ]


def binomial(keep: float, levels: int) -> FloatArray:
    """(levels,): entry j is the probability that j of `levels` - 1 draws lower the level, each
    with probability 1 - keep."""
    draws = levels - 1
    terms = [math.comb(draws, j) * keep ** (draws - j) * (1 - keep) ** j for j in range(levels)]
    return np.array(terms) / math.fsum(terms)
