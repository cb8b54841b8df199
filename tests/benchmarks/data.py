"""What is measured on: the paper's run 1, or a simulated drive of the same kind."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.model import make_evidence
from egolane_pgm.paper import paper_experiment
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.runs import open_input
from egolane_pgm.types import Evidence, LineLog

BAG = "rle/special.issue.italy.mono.noClothoid.yesLines.bag"
N_LANES = 4
#: Where there is no recording.
SIMULATED = {"recording": {"path": None, "frames": None, "simulate": "a4"}, "ground_truth": None}


@dataclass(frozen=True)
class Data:
    """log, truth: T frames each."""

    log: LineLog
    truth: pd.DataFrame
    parameters: Parameters
    evidence: Evidence
    compiled: Compiled
    source: str


def load() -> Data:
    has_bag = (Path(os.environ.get("EGOLANE_DATA", "")) / BAG).exists()
    [drive] = open_input(paper_experiment(1), overrides={} if has_bag else SIMULATED).drives()
    log, model = drive.log.take(drive.rows), drive.model
    lane, is_crossing = drive.true_lane[drive.rows], drive.is_crossing[drive.rows]
    truth = pd.DataFrame({"true_lane": lane, "is_crossing": is_crossing})
    source = "run 1 of the paper" if has_bag else "a simulated drive (EGOLANE_DATA has no run 1)"
    return Data(
        log,
        truth,
        model.parameters,
        make_evidence(model, log)[0],
        model.compiled,
        f"{source}, {len(log)} frames",
    )


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
