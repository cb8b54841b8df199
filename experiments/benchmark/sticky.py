"""A hidden Markov model without a sensor: the lane is kept, or drawn anew, and the evidence rule's
vector is the likelihood of the lane. With `stay` 0 each frame is answered by itself."""

import numpy as np

import egolane_pgm as ego
from egolane_pgm.graphs.cpds import builder, dynamics, previous, prior, uniform, within

HIDDEN = ("Lane",)
OBSERVED = ("DetectorOutput",)
UNUSED = ("WOR",)
PARAMETERS = (
    ego.Parameter(
        "stay", "probability", 0.99, "P(the lane is kept), else drawn anew", search=(0.9, 1.0)
    ),
)


def tables(n_lanes, parameters):
    stay = float(parameters["stay"])
    kept = stay * np.eye(n_lanes) + (1 - stay) / n_lanes
    return [
        *prior("Lane", uniform(n_lanes)),
        *dynamics("Lane", [previous("Lane")], kept),
        *within("DetectorOutput", ["Lane"], np.eye(n_lanes)),
    ]


build = builder(tables, OBSERVED)
