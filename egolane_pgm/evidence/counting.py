"""The paper's evidence rule (section "Tentative vector and reliability of the whole detection"), as
its authors computed it. Each valid line votes for the lanes that it is compatible with, and a
continuous line gives a bonus to the lane that it bounds. The sum of the reliability indices (LRI)
of all valid lines gives the WOR. A frame without a valid line has a uniform tentative vector and
the lowest WOR.

A detector without a continuous flag gives no bonus. Without LRI (NaN) every valid line counts as
fully reliable; the WOR then is the detected share of the n + 1 expected lines.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, Evidence, FloatArray, LineLog

PROVIDES = ("DetectorOutput", "WOR")

#: The node whose evidence is itself a belief over lanes: "detector only" in the paper's tables.
TENTATIVE = "DetectorOutput"

PARAMETERS = (
    Parameter(
        "bonus_value",
        "non_negative",
        1,
        "votes of a continuous line for the lane that it bounds; BV of equation `eq:HMM`",
        search=(0, 9),
    ),
    Parameter("lane_width_m", "positive", 3.5, "lane width in the detector's metres", search=None),
    Parameter(
        "tentative_noise",
        "non_negative",
        0.001,
        "added to every entry of the tentative vector",
        search=None,
    ),
    Parameter(
        "max_lri", "positive", 10, "largest value of a line's reliability index", search=None
    ),
)

#: Subtracted from WOR. A value that is then below 0 becomes this, and from 1 on 1 less this.
WOR_NOISE = 0.01


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """The evidence of T frames: DetectorOutput (T, n), the tentative vector, which sums to one, and
    WOR (T, 2) with the columns OK and BAD.

    parameters: checked values of PARAMETERS.
    """
    tentative = np.zeros((len(log), n_lanes))
    wor = np.empty((len(log), 2))
    count_lines(
        log.offset_m,
        log.is_valid,
        log.is_continuous,
        log.lri,
        number(parameters, "lane_width_m"),
        number(parameters, "bonus_value"),
        number(parameters, "tentative_noise"),
        number(parameters, "max_lri"),
        tentative,
        wor,
    )
    return Evidence({"DetectorOutput": tentative, "WOR": wor})


@kernel()
def count_lines(
    offset_m: FloatArray,
    is_valid: BoolArray,
    is_continuous: BoolArray,
    lri: FloatArray,
    lane_width_m: float,
    bonus_value: float,
    tentative_noise: float,
    max_lri: float,
    tentative: FloatArray,
    wor: FloatArray,
) -> None:
    """Add the votes of the lines, (T, L) each, to `tentative` (T, n) and normalise it; fill `wor`
    (T, 2)."""
    n_lanes = tentative.shape[1]
    for t in range(offset_m.shape[0]):
        reliability = 0.0
        total = 0.0
        for line in range(offset_m.shape[1]):
            if not is_valid[t, line]:
                continue
            # NaN differs from itself; a line without LRI counts as fully reliable.
            reliability += lri[t, line] if lri[t, line] == lri[t, line] else max_lri
            d = offset_m[t, line]
            distance = abs(d)
            if distance <= lane_width_m:
                if is_continuous[t, line]:
                    lane = 0 if d < 0 else n_lanes - 1
                    tentative[t, lane] += bonus_value
                    total += bonus_value
                continue
            for k in range(n_lanes):
                if distance < (k + 1) * lane_width_m:
                    tentative[t, n_lanes - 1 - k if d > 0 else k] += 1.0
                    total += 1.0
            if is_continuous[t, line] and distance / lane_width_m < n_lanes:
                away = int(distance / lane_width_m)
                tentative[t, n_lanes - 1 - away if d > 0 else away] += bonus_value
                total += bonus_value
        if total == 0.0:
            for lane in range(n_lanes):
                tentative[t, lane] = 1.0
            total = float(n_lanes)
        total += n_lanes * tentative_noise
        for lane in range(n_lanes):
            tentative[t, lane] = (tentative[t, lane] + tentative_noise) / total
        s = reliability / (max_lri * (n_lanes + 1)) - WOR_NOISE
        if s < 0.0:
            s = WOR_NOISE
        elif s >= 1.0:
            s = 1.0 - WOR_NOISE
        wor[t, 0] = s
        wor[t, 1] = 1.0 - s
