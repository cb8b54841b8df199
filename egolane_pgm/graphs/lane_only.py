"""A plain hidden Markov model: Lane is the parent of DetectorOutput, and the sensor never fails."""

from __future__ import annotations

from egolane_pgm.graphs.cpds import (
    Table,
    dynamics,
    lane_normals,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.graphs.sensor_failure import SIGMA1, SIGMA2
from egolane_pgm.parameters import Parameters, number

HIDDEN = ("Lane",)
OBSERVED = ("DetectorOutput",)
UNUSED = ("WOR",)
PARAMETERS = (SIGMA1, SIGMA2)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """Table `tab:cptlane`, and the OK rows of Table `tab:cptdetlane`."""
    sigma1, sigma2 = number(parameters, "sigma1"), number(parameters, "sigma2")
    return [
        *prior("Lane", uniform(n_lanes)),
        *dynamics("Lane", [previous("Lane")], lane_normals(sigma1, n_lanes)),
        *within("DetectorOutput", ["Lane"], lane_normals(sigma2, n_lanes)),
    ]
