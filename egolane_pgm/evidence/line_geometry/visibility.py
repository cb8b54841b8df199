"""Visibility of lines: a belief over a few kinds of detectors and roads, from the frames so far.

The range of a camera, its continuous flags and lines off the road are unknown, and constant for
minutes. A model with fixed constants would count the same surprise in each frame: a camera of two
lines never shows an outer lane, which is no evidence of a lane. So each kind is a set of changes to
the generic constants, and a belief over kinds is kept for each lane. The likelihood of a lane is
the mean over its kinds, weighted by their predictions of the previous frames (kernel
`weigh_positions`). What never changes on a drive is no evidence once a kind explains it in every
lane.

The kinds, their constants and the rates were chosen on the paper's ten recordings and the public
part of the benchmark.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.evidence.line_geometry.kernels import MOST_BESIDE
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

#: A line is seen off the road, on the hard shoulder (in traffic that keeps to the right).
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

#: The probability of the last kind from which a note is given.
SURE = 0.8

#: A line further away than this, in lane widths, does not belong to the own lane.
FAR_WIDTHS = 1.2

#: A camera shows its own lane only if fewer than this share of the frames so far has a far line.
FAR_SHARE = 0.1

#: The probability in a tenth of a second that the car goes to the lane on either side, as far as
#: the belief over kinds is concerned.
LANE_CHANGES = 0.002

#: The probability in a tenth of a second that the detector or the road becomes another kind.
KIND_CHANGES = 0.0013


@dataclass(frozen=True)
class VisibilityTables:
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


def visibility_models(n_lanes: int, parameters: Mapping[str, Value]) -> list[LineModel]:
    """Return a model for each kind, or the only one if its constants are given or learned."""
    if any(not isinstance(parameters[name], str) for name in FITTED):
        return [line_model(n_lanes, parameters)]
    return [line_model(n_lanes, parameters, kind) for kind in KINDS]


def visibility_tables(models: Sequence[LineModel], *, has_flags: bool) -> VisibilityTables:
    """Tabulate the models of all kinds, for a detector with or without a continuous flag."""
    used = models if has_flags else [without_flags(model) for model in models]
    of_kinds = np.concatenate([log_intensity(model, LANE_M) for model in used])
    return VisibilityTables(
        np.ascontiguousarray(of_kinds.transpose(1, 2, 0)),
        np.log(np.exp(of_kinds).mean(axis=0)),
        -(REACH_M + LANE_M),
        np.array([model.expected for model in used]),
        LANE_M,
    )


def new_visibility(n_lanes: int, n_kinds: int) -> FloatArray:
    """The belief over the lane and the kind before the first frame, (n, K)."""
    return np.full((n_lanes, n_kinds), 1 / (n_lanes * n_kinds))


def new_patterns() -> FloatArray:
    """How long each pattern of lines was seen before the first frame, (M, M)."""
    return np.zeros((MOST_BESIDE + 1, MOST_BESIDE + 1))


def far_frames(offset_m: FloatArray, width_m: FloatArray) -> int:
    """Return the number of frames with a line beyond the ego lane.

    - offset_m: (T, L), NaN in padding. width_m: (T,) lane width.
    """
    with np.errstate(invalid="ignore"):
        is_far = np.abs(offset_m) > FAR_WIDTHS * width_m[:, None]
    return int(is_far.any(axis=1).sum())


def warn_of_own_lines(
    visibility: FloatArray, lines_per_frame: float, far_share: float, source: str
) -> None:
    """Warn of a camera that shows only the ego lane's lines.

    - visibility: (n, K) the posterior over lanes and kinds after the frames so far.
    - far_share: the share of these frames with a line beyond (`far_frames`).
    """
    is_own = visibility.shape[1] == len(KINDS) and visibility[:, -1].sum() > SURE
    if is_own and lines_per_frame > 1 and far_share < FAR_SHARE:
        warnings.warn(
            f"{NOTE}{source}: shows the lines of its own lane only: the absolute lane is ambiguous"
            " until a lane change rules lanes out; set `start_lane` if you know it; lane changes"
            " are tracked",
            UserWarning,
            stacklevel=2,
        )
