"""The paper's evidence rule (`counting`) for the graph `wor_levels`, where WOR has `wor_levels`
levels, the most reliable one first.

`counting` gives a reliability s between 0 and 1, which is shared between the two levels nearest to
s: level j of k is at s = 1 - j / (k - 1). With two levels this is `counting`.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.evidence import counting
from egolane_pgm.graphs.sensor_failure import WOR_LEVELS
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import Evidence, FloatArray, LineLog

PROVIDES = counting.PROVIDES
TENTATIVE = counting.TENTATIVE
PARAMETERS = (*counting.PARAMETERS, WOR_LEVELS)


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """Return the evidence of T frames: DetectorOutput (T, n) as in `counting`, and WOR (T, k),
    which sums to one.

    parameters: checked values of PARAMETERS.
    """
    given = counting.evidence(log, n_lanes, parameters).likelihoods
    levels = int(parameters["wor_levels"])  # type: ignore[arg-type]
    wor = level_evidence(given["WOR"][:, 0], levels)
    return Evidence({"DetectorOutput": given["DetectorOutput"], "WOR": wor})


def level_evidence(reliability: FloatArray, levels: int) -> FloatArray:
    """Return the evidence of k levels, (T, k), for reliabilities (T,) between 0 and 1."""
    frames = np.arange(len(reliability))
    rows = np.zeros((len(reliability), levels))
    place = (1 - reliability) * (levels - 1)
    upper = np.minimum(place.astype(np.int64), levels - 2)
    rows[frames, upper + 1] = place - upper
    rows[frames, upper] = 1 - (place - upper)
    return rows
