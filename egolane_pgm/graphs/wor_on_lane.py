"""The paper's graph in which WOR also depends on Lane, as the paper's section "HMM with Transient
Failure Model" suggests: on an outer lane a working detector sees fewer lines.

Each of `p3` and `p4` is one number or one per lane. With equal numbers for all lanes this is the
graph `sensor_failure`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, binary, within
from egolane_pgm.parameters import Parameters, per_lane

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = tuple(
    replace(p, per_lane=True) if p.name in ("p3", "p4") else p for p in sensor_failure.PARAMETERS
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with one Table `tab:cptri` for each lane."""
    p3 = per_lane(parameters, "p3", n_lanes)
    p4 = per_lane(parameters, "p4", n_lanes)
    wor = np.stack([binary(ok, bad) for ok, bad in zip(p3, p4, strict=True)])
    return [
        *sensor_failure.tables_without_wor(n_lanes, parameters),
        *within("WOR", ["Lane", "SensorState"], wor),
    ]
