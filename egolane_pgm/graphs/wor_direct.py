"""WOR in the place of SensorState: it says of each frame by itself whether the detector output can
be trusted, and nothing about the sensor is carried from frame to frame.

WOR is observed and a parent of DetectorOutput; what is known of it is its evidence and `p_wor`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior, uniform, within
from egolane_pgm.graphs.shared_parameters import (
    LANE_WIDTHS,
    NORMAL,
    SIGMA1,
    SIGMA2,
    f_table,
    number,
)
from egolane_pgm.parameters import Parameter, Parameters

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork

HIDDEN = ("Lane",)
OBSERVED = ("DetectorOutput", "WOR")
PARAMETERS = (
    SIGMA1,
    SIGMA2,
    Parameter("p_wor", "probability", 0.5, "P(WOR OK) in any frame", search=(0.0, 1.0)),
    NORMAL,
    LANE_WIDTHS,
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """Tables `tab:cptlane` and `tab:cptdetlane`, the latter's rows selected by WOR."""
    p_wor = number(parameters["p_wor"])
    outputs = [f_table("sigma2", n_lanes, parameters), uniform(n_lanes, n_lanes)]
    return [
        *prior("Lane", uniform(n_lanes)),
        *dynamics("Lane", [previous("Lane")], f_table("sigma1", n_lanes, parameters)),
        *within("WOR", [], [p_wor, 1 - p_wor]),
        *within("DetectorOutput", ["WOR", "Lane"], np.stack(outputs)),
    ]


def build(n_lanes: int, parameters: Parameters) -> DynamicBayesianNetwork:
    """The network, declared."""
    return declare(tables(n_lanes, parameters), OBSERVED)
