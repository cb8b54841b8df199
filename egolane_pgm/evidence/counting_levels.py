"""The paper's evidence rule (`counting`) for the graph `wor_levels`, where WOR has `wor_levels`
levels, the most reliable one first.

`counting` gives a reliability s between 0 and 1, which becomes evidence over the levels. `linear`
shares it between the two levels nearest to s, where level j of k is at s = 1 - j / (k - 1).
`one_hot` divides 0 to 1 into k equal intervals and takes the one that s is in. With two levels
`linear` is `counting`.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.evidence import counting
from egolane_pgm.graphs.sensor_failure import WOR_LEVELS
from egolane_pgm.parameters import Parameter, Parameters
from egolane_pgm.types import Evidence, FloatArray, LineLog

PROVIDES = counting.PROVIDES
TENTATIVE = counting.TENTATIVE
PARAMETERS = (
    *counting.PARAMETERS,
    WOR_LEVELS,
    Parameter(
        "level_evidence",
        "choice",
        "linear",
        "a reliability between two levels: `linear` is shared by both, `one_hot` is given to the"
        " level whose interval it is in",
        choices=("linear", "one_hot"),
    ),
)


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """The evidence of T frames: DetectorOutput (T, n) as in `counting`, and WOR (T, k), which sums
    to one.

    parameters: checked values of PARAMETERS.
    """
    given = counting.evidence(log, n_lanes, parameters).likelihoods
    levels = int(parameters["wor_levels"])  # type: ignore[arg-type]
    wor = level_evidence(given["WOR"][:, 0], levels, str(parameters["level_evidence"]))
    if parameters["no_valid_line"] == "ignore":
        wor[~log.is_valid.any(axis=1)] = 1 / levels
    return Evidence({"DetectorOutput": given["DetectorOutput"], "WOR": wor})


def level_evidence(reliability: FloatArray, levels: int, how: str) -> FloatArray:
    """Evidence over k levels, (T, k), for reliabilities (T,) between 0 and 1."""
    frames = np.arange(len(reliability))
    rows = np.zeros((len(reliability), levels))
    if how == "one_hot":
        level = np.minimum(((1 - reliability) * levels).astype(np.int64), levels - 1)
        rows[frames, level] = 1.0
        return rows
    place = (1 - reliability) * (levels - 1)
    upper = np.minimum(place.astype(np.int64), levels - 2)
    rows[frames, upper + 1] = place - upper
    rows[frames, upper] = 1 - (place - upper)
    return rows
