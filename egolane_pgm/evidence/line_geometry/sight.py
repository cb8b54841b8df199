"""What a detector shows on this road: a belief over a few kinds of it, from the frames so far.

How far a camera sees, which lines it marks as continuous, and whether there is a line beside the
road, is not known of a stranger's drive, and stays as it is for minutes. A model that takes one
answer for granted counts the same surprise in each frame: a camera of two lines never shows an
outer lane, and so is sure of a lane where there is no evidence. Here each kind is a set of changes
of the generic constants, and a belief over kinds is kept for each lane that the car may be in. The
likelihood of a lane is then the mean over its kinds, weighed by how well each predicted the frames
before (the kernel `weigh_positions`). What never changes on a drive stops to count as evidence as
soon as a kind explains it in every lane.

The kinds, their constants and the rates below were chosen with the paper's ten recordings and the
public part of the benchmark in sight.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.evidence.line_geometry.model import (
    FITTED,
    GENERIC,
    LANE_M,
    REACH_M,
    Kind,
    LineModel,
    line_model,
    log_intensity,
    without_flags,
)
from egolane_pgm.parameters import Value
from egolane_pgm.types import NOTE, FloatArray

#: A line is seen beside the road, where vehicles stop (in traffic that keeps to the right).
_ROADSIDE = {"shoulder_right": 0.8}

#: The road's outer lines are continuous, and reported as such.
_MARKED = {"edge_continuous": 0.7}

#: Lines beyond the next one are rare.
_SHORT = {"fade": 0.45, "seen_far": 0.1}

#: Near lines are missed as often as far ones.
_EVEN = {"seen_near": 0.55, "fade": 0.1}

#: Only the lines of the own lane are reported, and never as continuous.
_OWN = {
    "fade": 1.0,
    "seen_far": 0.02,
    "shoulder_left": 0.02,
    "shoulder_right": 0.02,
    "edge_continuous": 0.05,
}

_REACHES: tuple[dict[str, Any], ...] = ({}, _SHORT, _EVEN)

#: The kinds, which are equally probable before the first frame.
KINDS: tuple[Kind, ...] = (
    *(
        replace(GENERIC, **reach, **marks, **beside)
        for reach in _REACHES
        for marks in ({}, _MARKED)
        for beside in ({}, _ROADSIDE)
    ),
    replace(GENERIC, **_OWN),
)

#: The probability from which a note says that only the own lines are seen.
SURE = 0.8

#: The probability in a tenth of a second that the car goes to the lane on either side, as far as
#: the belief over kinds is concerned, and that the detector or the road becomes of another kind.
LANE_CHANGES, KIND_CHANGES = 0.002, 0.003


@dataclass(frozen=True)
class SightTables:
    """The models of K kinds for n lanes, tabulated for one lane width at z = first_m +
    TABLE_STEP_M * index.

    - log_intensity: (4, Z, K n) logarithm of the intensity, per class, place, and kind and lane
    - log_mean: (4, Z) logarithm of the mean intensity over kinds and lanes
    - expected: (K, n) Lambda
    """

    log_intensity: FloatArray
    log_mean: FloatArray
    first_m: float
    expected: FloatArray
    width_m: float


def kinds_of(n_lanes: int, parameters: Mapping[str, Value]) -> list[LineModel]:
    """The models that are possible: one for each kind, or the only one where its constants are
    given or learned."""
    is_known = any(not isinstance(parameters[name], str) for name in FITTED)
    if is_known or parameters["sight"] == "generic":
        return [line_model(n_lanes, parameters)]
    return [line_model(n_lanes, parameters, kind) for kind in KINDS]


def sight_tables(models: Sequence[LineModel], *, has_flags: bool) -> SightTables:
    """Tabulates the models of all kinds, as of a detector that marks lines as continuous or not."""
    used = models if has_flags else [without_flags(model) for model in models]
    of_kinds = np.concatenate([log_intensity(model, LANE_M) for model in used])
    return SightTables(
        np.ascontiguousarray(of_kinds.transpose(1, 2, 0)),
        np.log(np.exp(of_kinds).mean(axis=0)),
        -(REACH_M + LANE_M),
        np.array([model.expected for model in used]),
        LANE_M,
    )


def new_sight(n_lanes: int, n_kinds: int) -> FloatArray:
    """The belief over the lane and the kind before the first frame, (n, K)."""
    return np.full((n_lanes, n_kinds), 1 / (n_lanes * n_kinds))


def warn_of_own_lines(sight: FloatArray, lines_per_frame: float, source: str) -> None:
    """Notes that only the lines of the own lane are seen, where that is sure after the frames so
    far."""
    is_own = sight.shape[1] == len(KINDS) and sight[:, -1].sum() > SURE
    if is_own and lines_per_frame > 1:
        warnings.warn(
            f"{NOTE}{source}: shows the lines of its own lane only: until a lane change leaves one"
            " answer, the lane is known as far as that in which the drive begins is (`start_lane`);"
            " lane changes are followed",
            UserWarning,
            stacklevel=2,
        )
