"""Logs of lines at given offsets, and the parameters of the line geometry."""

from __future__ import annotations

from typing import Any

import numpy as np

from egolane_pgm.evidence import line_geometry
from egolane_pgm.graphs import position_in_lane
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import LineLog


def line_log(offsets: Any, **given: Any) -> LineLog:
    """Valid dashed lines of LRI 10, ten frames a second; NaN where there is none.

    given: other fields; one LRI is that of every line.
    """
    offset = np.array(offsets, dtype=float)
    valid, lri = np.isfinite(offset), np.asarray(given.pop("lri", 10.0))
    frame_id = np.asarray(given.pop("frame_id", np.arange(len(offset))))
    fields = {
        "is_valid": valid,
        "is_continuous": np.zeros(offset.shape, dtype=bool),
        "lri": lri if lri.ndim else np.where(valid, lri, np.nan),
        **{name: np.asarray(values) for name, values in given.items()},
    }
    return LineLog(frame_id, frame_id / 10, offset, **fields)


def resolved(n_lanes: int = 3, **given: object) -> Parameters:
    """The parameters of the rule and its graph."""
    specs = {p.name: p for p in (*line_geometry.PARAMETERS, *position_in_lane.PARAMETERS)}
    return resolve_parameters(specs.values(), given, n_lanes)
