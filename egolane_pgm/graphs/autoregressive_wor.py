"""The graph `autoregressive` in which WOR persists too: WOR at t+1 depends on WOR at t, as it does
if it is computed from counters that grow and fall by one in each frame.

With probability `p_repeat_wor` WOR keeps its value in any sensor state; otherwise it is drawn
as in the paper. With that at zero this is the graph `autoregressive`; filter with `exact`, as
there. Its tables are the ones to learn by EM: neither lines nor WOR of neighbouring frames are
taken for independent.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import autoregressive
from egolane_pgm.graphs.cpds import Table, dynamics, previous, prior
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = autoregressive.HIDDEN
OBSERVED = autoregressive.OBSERVED
VALUES = autoregressive.VALUES
PARAMETERS = (
    *autoregressive.PARAMETERS,
    Parameter("p_repeat_wor", "probability", 0.5, "P(WOR keeps its value of the frame before)"),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `autoregressive`, with a row of Table `tab:cptri` for each WOR before."""
    before = autoregressive.tables(n_lanes, parameters)
    (fresh,) = (t.values for t in before if t.node == ("WOR", 0))
    p = number(parameters, "p_repeat_wor")
    # Axes: SensorState, the WOR before, WOR.
    after = p * np.eye(2) + (1 - p) * fresh[:, None, :]
    return [
        *(t for t in before if t.node[0] != "WOR"),
        *prior("WOR", fresh, ["SensorState"]),
        *dynamics("WOR", ["SensorState", previous("WOR")], after),
    ]
