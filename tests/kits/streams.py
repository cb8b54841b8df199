"""The frames of a drive as they come, one by one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from egolane_pgm.types import LineLog


def messages(log: LineLog) -> Iterator[str]:
    """The frames of a log as a detector would send them: padding left out."""
    for t in range(len(log)):
        lines: list[dict[str, Any]] = []
        for k in range(log.offset_m.shape[1]):
            if np.isnan(log.offset_m[t, k]) and np.isnan(log.lri[t, k]):
                continue
            line = {
                "offset_m": None if np.isnan(log.offset_m[t, k]) else float(log.offset_m[t, k]),
                "is_valid": bool(log.is_valid[t, k]),
                "is_continuous": bool(log.is_continuous[t, k]),
            }
            if not np.isnan(log.lri[t, k]):
                line["lri"] = float(log.lri[t, k])
            lines.append(line)
        yield json.dumps({"frame_id": int(log.frame_id[t]), "lines": lines}) + "\n"
