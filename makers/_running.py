"""Run an experiment on lines in memory."""

from __future__ import annotations

import warnings
from typing import Any

import egolane_pgm as ego

#: The paper's evidence, graph and filter.
PAPER = {"evidence": "counting", "graph": "sensor_failure", "filter": "assumed_density"}


def run_of(log: ego.LineLog, n_lanes: int, frame_rate: float, **keys: Any) -> ego.Result:
    """Run the paper's model on lines; `keys` override PAPER."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return ego.run(
            log,
            experiment={**PAPER, **keys},
            n_lanes=n_lanes,
            overrides={"recording.frame_rate": frame_rate},
        )
