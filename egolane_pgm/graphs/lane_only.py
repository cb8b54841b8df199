"""A plain hidden Markov model: Lane is the parent of DetectorOutput, and the sensor never fails."""

from __future__ import annotations

from egolane_pgm.graphs.cpds import Table, builder, dynamics, previous, prior, uniform, within
from egolane_pgm.graphs.sensor_failure import LANE_WIDTHS, NORMAL, SIGMA1, SIGMA2, f_table
from egolane_pgm.parameters import Parameters

HIDDEN = ("Lane",)
OBSERVED = ("DetectorOutput",)
UNUSED = ("WOR",)
PARAMETERS = (SIGMA1, SIGMA2, NORMAL, LANE_WIDTHS)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """Table `tab:cptlane`, and the OK rows of Table `tab:cptdetlane`."""
    return [
        *prior("Lane", uniform(n_lanes)),
        *dynamics("Lane", [previous("Lane")], f_table("sigma1", n_lanes, parameters)),
        *within("DetectorOutput", ["Lane"], f_table("sigma2", n_lanes, parameters)),
    ]


build = builder(tables, OBSERVED)
