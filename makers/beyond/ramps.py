"""Lane changes on a simulated road of two lanes which a ramp joins, with n = 2.

The ramp's outer line comes in from the side over a second and a half, is there for five to ten
seconds and ends over two more. The car changes lane away from it meanwhile, or stays in one lane.
Half of the roads are mirrored, of three drives one has failures and one has no continuous flags.
The rule of events was made with seeds 0 to 11 in sight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.simulation.detector import PRESETS, detect_lines, sensor_failures
from egolane_pgm.simulation.world import Road, slow_noise
from egolane_pgm.types import LineLog
from makers._running import run_of

WIDTH_M = 3.6
WITHIN_S = 2.5
SEEDS = range(100, 112)

#: The lane next to the ramp is 1, before the road is mirrored.
STARTS = {"changes away from the ramp": (1, 2), "stays beside it": (1, 1), "stays away": (2, 2)}

#: Frames a second, and seconds before the ramp joins.
TIMES = ((10.0, 15.0), (10.0, 4.0), (10.0, 0.0), (10 / 3, 4.0), (10 / 3, 0.0))

GRAPHS: dict[str, dict[str, Any]] = {
    "the paper's graph": {},
    "zero labels": {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"},
}

TEXT = """\
# Lane changes where a ramp joins

A simulated road of two lanes, with `n_lanes: 2`; a ramp joins from one side for 5 to 10 s
(`makers/beyond/ramps.py`). Shares of drives with one change detected, to the right side and within
2.5 s of the line, or none if the car makes none. The seeds were not used when the
rule of events was made. All drives are simulated.

The paper's graph has no position in the lane: the lateral offset comes from the lines alone. The
remaining errors are bursts of failures in which all lines are reported shifted.
"""


@dataclass(frozen=True)
class RampDrive:
    """log: the lines. crossed_s: when the car's middle crosses the line; NaN if it does not. side:
    to which side, -1 or 1."""

    log: LineLog
    crossed_s: float
    side: int


def ramp_drive(
    seed: int, lanes: tuple[int, int], preset: str, rate: float, lead_s: float, *, mirrored: bool
) -> RampDrive:
    """A drive from the first of two lanes to the second, which may be the same."""
    rng = np.random.default_rng([seed, 77])
    ramp_s = rng.uniform(5, 10)
    time_s = np.arange(int((lead_s + ramp_s + 12) * rate)) / rate
    middle_s, change_s = lead_s + rng.uniform(0.3, 0.8) * ramp_s, rng.uniform(3.5, 6)
    phase = np.clip((time_s - middle_s) / change_s + 0.5, 0, 1)
    done = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    wander = slow_noise(rng, len(time_s), 1, 5 * rate)[:, 0]
    position = (lanes[0] + (lanes[1] - lanes[0]) * done - 0.5) * WIDTH_M
    position += 0.5 * np.tanh(wander / 2.5)
    end_s = lead_s + ramp_s
    away = 1 + 0.8 * np.clip((lead_s - time_s) / 1.5, 0, 1)
    away -= 0.9 * np.clip((time_s - end_s) / 2, 0, 1)
    is_there = (time_s > lead_s - 1.5) & (time_s < end_s + 2)
    outer = np.where(is_there, -away * WIDTH_M, np.nan)
    lines = [outer, *(np.full(len(time_s), k * WIDTH_M) for k in range(3))]
    lane = np.full(len(time_s), 1)
    road = Road(
        rate,
        3,
        position,
        lane,
        lane < 0,
        np.column_stack(lines) - position[:, None],
        np.full(len(lane), np.nan),
    )
    detector = PRESETS[preset].detector
    fails = sensor_failures(detector, road, seed) & (seed % 2 == 1)
    log = detect_lines(road, fails, detector, seed)
    if seed % 3 == 2:
        log = replace(log, is_continuous=np.zeros_like(log.is_continuous))
    if mirrored:
        log = replace(log, offset_m=-log.offset_m)
    crosses = lanes[0] != lanes[1]
    crossed_s = float(time_s[np.argmax(position > WIDTH_M)]) if crosses else np.nan
    return RampDrive(log, crossed_s, (-1 if mirrored else 1) if crosses else 0)


def events_of(drive: RampDrive, rate: float, graph: str) -> pd.DataFrame:
    """The lane changes that a run detects on a road of two lanes."""
    return run_of(drive.log, 2, rate, **GRAPHS[graph]).events


def is_right(drive: RampDrive, events: pd.DataFrame) -> bool:
    """Whether one change is detected, to the right side and within WITHIN_S; or none, if there is
    none."""
    near = (events["detected_time_s"] - drive.crossed_s).abs() <= WITHIN_S
    sides = events.loc[near, "direction"].tolist() if drive.side else []
    return len(events) == len(sides) and sides == [drive.side] * abs(drive.side)


def measure() -> Iterator[str]:
    """The shares of drives in which the right changes are detected, as a table."""
    yield TEXT
    yield f"| of {len(SEEDS) * 2 * len(PRESETS)} drives each | {' | '.join(GRAPHS)} |"
    yield "|---|--:|--:|"
    for (name, lanes), (rate, lead_s) in product(STARTS.items(), TIMES):
        cells = []
        for graph in GRAPHS:
            right = [
                is_right(drive, events_of(drive, rate, graph))
                for preset, seed, mirrored in product(PRESETS, SEEDS, (False, True))
                for drive in [ramp_drive(seed, lanes, preset, rate, lead_s, mirrored=mirrored)]
            ]
            cells.append(f"{np.mean(right):.2f}")
        yield (
            f"| {name}, {rate:.3g} frames a second, ramp after {lead_s:g} s | {' | '.join(cells)} |"
        )
