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


def over_and_over(log: LineLog, n_frames: int, frame_rate: float) -> Iterator[LineLog]:
    """So many frames, one by one: those of a log, again and again, with ids that go on."""
    length = int(log.frame_id[-1] - log.frame_id[0]) + 1
    is_line = ~(np.isnan(log.offset_m) & np.isnan(log.lri))
    for number in range(n_frames):
        lap, t = divmod(number, len(log))
        here = is_line[t]
        yield LineLog.from_rows(
            log.frame_id[[t]] + lap * length,
            frame_rate,
            np.zeros(here.sum(), dtype=int),
            log.offset_m[t, here],
            log.is_valid[t, here],
            log.is_continuous[t, here],
            log.lri[t, here],
        )
