"""The paper's graph in which WOR also depends on whether Lane is an edge lane (1 or n) or a middle
one: next to an edge lane the road ends, so that a working detector sees fewer lines there.

This is `wor_on_lane` with two values of each of p3 and p4, for any number of lanes. With equal
values for edge and middle lanes this is the graph `sensor_failure`. A road of one or two lanes has
edge lanes only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, binary, within
from egolane_pgm.graphs.sensor_failure import P3, P4
from egolane_pgm.parameters import Parameters, number

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = (
    *(p for p in sensor_failure.PARAMETERS if p not in (P3, P4)),
    replace(P3, name="p3_edge", doc="P(WOR OK | SensorState OK) in an edge lane"),
    replace(P3, name="p3_middle", doc="P(WOR OK | SensorState OK) in a middle lane"),
    replace(P4, name="p4_edge", doc="P(WOR BAD | SensorState BAD) in an edge lane"),
    replace(P4, name="p4_middle", doc="P(WOR BAD | SensorState BAD) in a middle lane"),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with one Table `tab:cptri` for edge lanes and one for middle lanes."""
    edge, middle = (
        binary(number(parameters, f"p3_{where}"), number(parameters, f"p4_{where}"))
        for where in ("edge", "middle")
    )
    wor = [edge if lane in (1, n_lanes) else middle for lane in range(1, n_lanes + 1)]
    return [
        *sensor_failure.tables_without_wor(n_lanes, parameters),
        *within("WOR", ["Lane", "SensorState"], np.stack(wor)),
    ]
