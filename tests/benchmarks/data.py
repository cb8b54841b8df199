"""What is measured on: the paper's run 1, or a simulated drive of the same kind."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.evidence import counting
from egolane_pgm.graphs import sensor_failure
from egolane_pgm.inference.compile import Compiled, compile_tables, with_tables
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence, LineLog

BAG = "rle/special.issue.italy.mono.noClothoid.yesLines.bag"
TRUTH = "rle/GT-A4FULL.txt"
FRAMES = (238, 10190)
N_LANES = 4
#: Run 1 of the paper, as published.
PARAMETERS = {"sigma1": 0.336, "sigma2": 0.696, "p1": 0.895, "p2": 0.894, "p3": 0.69, "p4": 0.461}
BONUS_VALUE = 7


@dataclass(frozen=True)
class Data:
    """log, truth: T frames each. read: reads the recording from its file, None without one."""

    log: LineLog
    truth: pd.DataFrame
    counting: Parameters
    evidence: Evidence
    compiled: Compiled
    source: str
    read: Callable[[], LineLog] | None


def load() -> Data:
    from egolane_pgm.recordings import read_lines
    from egolane_pgm.recordings.ground_truth import read_ground_truth
    from egolane_pgm.recordings.select import select_frames
    from egolane_pgm.simulation import simulate

    folder = Path(os.environ.get("EGOLANE_DATA", ""))
    bag = folder / BAG
    if os.environ.get("EGOLANE_DATA") and bag.exists():
        log = select_frames(read_lines(bag), *FRAMES)
        truth = read_ground_truth(folder / TRUTH)
        log = log.take(np.isin(log.frame_id, truth.index))
        truth = truth.loc[log.frame_id]
        source = "run 1 of the paper"
        read = lambda: read_lines(bag)  # noqa: E731
    else:
        drive = simulate("a4", seed=0, n_lanes=N_LANES)
        log, truth, read = drive.log, drive.truth, None
        source = "a simulated drive (preset a4; EGOLANE_DATA has no run 1)"
    rule = resolve_parameters(counting.PARAMETERS, {"bonus_value": BONUS_VALUE}, N_LANES)
    evidence = counting.evidence(log, N_LANES, rule)
    given = resolve_parameters(sensor_failure.PARAMETERS, PARAMETERS, N_LANES)
    tables = sensor_failure.tables(N_LANES, given)
    compiled = compile_tables(
        tables, hidden=sensor_failure.HIDDEN, observed=sensor_failure.OBSERVED
    )
    return Data(log, truth, rule, evidence, compiled, f"{source}, {len(log)} frames", read)


def parameter_sets(compiled: Compiled, n_sets: int) -> list[Compiled]:
    """Random parameter sets, seeded."""
    rng = np.random.default_rng(0)
    sets = []
    for _ in range(n_sets):
        given = {"sigma1": rng.uniform(0.1, 1.0), "sigma2": rng.uniform(0.1, 1.0)}
        given |= dict(zip(("p1", "p2", "p3", "p4"), rng.uniform(0.05, 0.95, 4), strict=True))
        values = resolve_parameters(sensor_failure.PARAMETERS, given, N_LANES)
        sets.append(with_tables(compiled, sensor_failure.tables(N_LANES, values)))
    return sets
