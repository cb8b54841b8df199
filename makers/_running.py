"""A run over lines in memory, as several figures need it."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from egolane_pgm.drive import Recorded
from egolane_pgm.results import Result

from egolane_pgm.experiment import make_experiment
from egolane_pgm.running import run_experiment
from egolane_pgm.types import LineLog


def run_of(log: LineLog, n_lanes: int, frame_rate: float, **keys: Any) -> Result:
    """The run over a recording; default: the paper's evidence, graph and filter with the parameters
    they have if nothing is said."""
    content = {
        "name": "lines",
        "recording": {"path": "lines", "frame_rate": frame_rate},
        "n_lanes": n_lanes,
        **keys,
    }
    experiment = make_experiment(content, Path(), "lines")
    recorded = Recorded(log, None, np.zeros(0, dtype=np.int64), (), ())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return run_experiment(experiment, recorded=recorded)
