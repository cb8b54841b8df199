"""The paper's graph with WOR depending on Lane too, as section "HMM with Transient Failure Model"
suggests: on an outer lane a working detector sees fewer lines.

`p3` and `p4` may be one number or one per lane; with equal numbers this is `sensor_failure`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, binary, declare, within
from egolane_pgm.graphs.shared_parameters import per_lane
from egolane_pgm.parameters import Parameters

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = tuple(
    replace(p, per_lane=True) if p.name in ("p3", "p4") else p for p in sensor_failure.PARAMETERS
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with Table `tab:cptri` once for each lane."""
    p3 = per_lane(parameters["p3"], n_lanes)
    p4 = per_lane(parameters["p4"], n_lanes)
    wor = np.stack([binary(ok, bad) for ok, bad in zip(p3, p4, strict=True)])
    return [
        *sensor_failure.tables_without_wor(n_lanes, parameters),
        *within("WOR", ["Lane", "SensorState"], wor),
    ]


def build(n_lanes: int, parameters: Parameters) -> DynamicBayesianNetwork:
    """The network, declared."""
    return declare(tables(n_lanes, parameters), OBSERVED)
