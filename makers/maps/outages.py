"""How right the lane is where lines are missing: by the lines, by positions, by both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from egolane_pgm.experiment import Gnss
from egolane_pgm.maps.interchange import InterchangeDrive, Journey, simulate_interchange
from egolane_pgm.maps.matching import match
from egolane_pgm.types import BoolArray, FloatArray
from makers.maps._drives import data, lane_belief, share, text
from tests.kits.tracks import offset_each_second, rotterdam_receivers, rotterdam_road

N_DRIVES = 24

#: Seconds without lines, once in each so many seconds, the first time after a minute.
OUTAGES, EVERY_S = (0, 10, 30, 60), 120.0

#: What the model takes for granted if it is wrong about the receiver and the lanes.
WRONG = Gnss(lane_width_m=3.5, sigma_m=1.0, drift_s=60.0)


def measure() -> Iterator[str]:
    """Lines of a table, for simulated and for recorded noise."""
    kinds = ("lines alone", "positions alone", "both", "both, wrong constants")
    yield f"| noise of the positions | without lines | {' | '.join(kinds)} |"
    yield "|---|---:|---:|---:|---:|---:|"
    seeds = range(1000, 1000 + N_DRIVES)
    recorded = recorded_noise()
    sources = {
        "simulated": [simulate_interchange(seed) for seed in seeds],
        "recorded": [_with_noise(seed, recorded) for seed in seeds],
    }
    for name, drives in sources.items():
        alone = [_right(drive, None, [Gnss()])[0] for drive in drives]
        for seconds in OUTAGES:
            scored = [_scored(drive, seconds) for drive in drives]
            # Frames without lines; all where there are none of those.
            right = [
                _right(d, s if seconds else np.zeros_like(s), [None, Gnss(), WRONG])
                for d, s in zip(drives, scored, strict=True)
            ]
            columns = [[r[0] for r in right], alone, [r[1] for r in right], [r[2] for r in right]]
            said = " | ".join(text(_share(column, drives, scored)) for column in columns)
            yield f"| {name} | {f'{seconds} s' if seconds else 'never'} | {said} |"


def _scored(drive: InterchangeDrive, seconds: float) -> BoolArray:
    """The frames without lines (T,), all for outages of 0 seconds."""
    behind = (drive.log.time_s - 60.0) % EVERY_S
    hidden = (behind < seconds) & (drive.log.time_s >= 60.0)
    return hidden if seconds else np.ones_like(hidden)


def _right(
    drive: InterchangeDrive, hidden: BoolArray | None, noise: list[Gnss | None]
) -> list[BoolArray]:
    """Whether the most probable lane is the right one in each frame (T,), for each of `noise`.
    hidden (T,): frames without lines, None for all."""
    blind = np.ones(len(drive), dtype=bool) if hidden is None else hidden
    beliefs, _ = lane_belief(drive, drive.road, blind, noise)
    return [belief.argmax(axis=1) + 1 == drive.truth.lane for belief in beliefs]


def _share(
    right: list[BoolArray], drives: list[InterchangeDrive], scored: list[BoolArray]
) -> tuple[float, float, float]:
    counted = [s & ~d.truth.is_crossing for s, d in zip(scored, drives, strict=True)]
    hits = [int((r & c).sum()) for r, c in zip(right, counted, strict=True)]
    return share(hits, [int(c.sum()) for c in counted])


def recorded_noise() -> list[FloatArray]:
    """How far two receivers in one car lie apart across the road, second by second, of each pair of
    four: bias, drift and jumps as they were."""
    graph, index = rotterdam_road(data())
    offset = {
        name: offset_each_second(drove.t_s, match(graph, index, drove).offset_m, 330.0, 3600.0)
        for name, drove in rotterdam_receivers(data()).items()
    }
    apart = [offset[a] - offset[b] for a, b in combinations(offset, 2)]
    return [series[np.isfinite(series)] for series in apart]


def _with_noise(seed: int, recorded: list[FloatArray]) -> InterchangeDrive:
    """A simulated drive whose positions err as in a part of a recorded series, either way."""
    drive = simulate_interchange(seed, None, Journey(gnss_m=0.0))
    rng = np.random.default_rng(seed)
    series = rng.choice([-1.0, 1.0]) * recorded[seed % len(recorded)]
    off = np.roll(series, -int(rng.integers(len(series))))[: len(drive.road)]
    return replace(drive, road=replace(drive.road, offset_m=drive.road.offset_m + off))
