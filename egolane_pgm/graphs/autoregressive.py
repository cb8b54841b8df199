"""The paper's graph with a detector whose answers persist: DetectorOutput at t+1 also depends on
DetectorOutput at t, so that neighbouring frames are not independent given Lane and SensorState.

With probability `p_repeat_ok` (`p_repeat_bad` when the sensor is BAD) the detector repeats its
output of the frame before, for any lane of the car; otherwise it answers as in the paper. A BAD
sensor that repeats is one that is stuck. With both at zero this is the graph `sensor_failure`.

The evidence for DetectorOutput is soft, so its value is latent and the belief needs it together
with Lane: filter with `exact`. `assumed_density` forgets after each frame which output goes with
which lane, and so takes an answer that is repeated for a new one.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, dynamics, previous, prior
from egolane_pgm.parameters import Parameter, Parameters, number

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = (
    *sensor_failure.PARAMETERS,
    Parameter(
        "p_repeat_ok", "probability", 0.5, "P(an OK sensor repeats its output of the frame before)"
    ),
    Parameter(
        "p_repeat_bad", "probability", 0.9, "P(a BAD sensor repeats its output of the frame before)"
    ),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, with a row of Table `tab:cptdetlane` for each output before."""
    paper = sensor_failure.tables(n_lanes, parameters)
    (fresh,) = (t.values for t in paper if t.node == ("DetectorOutput", 0))
    repeat = [number(parameters, name) for name in ("p_repeat_ok", "p_repeat_bad")]
    # Axes: SensorState, Lane, the output before, the output.
    p = np.reshape(repeat, (2, 1, 1, 1))
    after = p * np.eye(n_lanes) + (1 - p) * fresh[:, :, None, :]
    given = ["SensorState", "Lane"]
    return [
        *(t for t in paper if t.node[0] != "DetectorOutput"),
        *prior("DetectorOutput", fresh, given),
        *dynamics("DetectorOutput", [*given, previous("DetectorOutput")], after),
    ]
