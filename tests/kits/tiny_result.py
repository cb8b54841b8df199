"""A result directory of seven frames, as read, and how to read a figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.results import Result
from egolane_pgm.scoring.assign import assigned_lane

#: Ids 100 to 107 with 104 missing; 102 and 103 are crossing, 107 is not annotated.
IDS = [100, 101, 102, 103, 105, 106, 107]
TRUTH = [1, 1, 1, 2, 2, 2, 0]
CROSSING = [0, 0, 1, 1, 0, 0, 0]
MODEL = [
    [0.90, 0.08, 0.02],
    [0.70, 0.20, 0.10],
    [0.50, 0.40, 0.10],
    [0.20, 0.70, 0.10],
    [0.10, 0.80, 0.10],
    [0.05, 0.35, 0.60],
    [0.02, 0.90, 0.08],
]
DETECTOR = [
    [0.40, 0.40, 0.20],
    [0.10, 0.20, 0.70],
    [1 / 3, 1 / 3, 1 / 3],
    [0.20, 0.60, 0.20],
    [0.20, 0.60, 0.20],
    [0.60, 0.20, 0.20],
    [0.20, 0.20, 0.60],
]


EXPERIMENT = Experiment.model_validate(
    {"name": "tiny", "n_lanes": 3, "recording": {"simulate": "quickstart"}}
)


def a_result(**changes: Any) -> Result:
    model, detector = np.array(MODEL), np.array(DETECTOR)
    result = Result(
        directory=Path("results/tiny"),
        experiment=EXPERIMENT,
        config={"parameters": {"bonus_value": 4.0, "sigma1": 0.3}, "graph": "sensor_failure"},
        run={"name": "tiny", "n_lanes": 3, "frame_rate": 10.0, "tuned_on": "same_frames"},
        scores={},
        frame_id=np.array(IDS),
        time_s=np.array(IDS) / 10,
        marginals={"Lane": model},
        values={"Lane": ("1", "2", "3")},
        tentative=detector,
        assigned_lane=assigned_lane(model),
        true_lane=np.array(TRUTH),
        is_crossing=np.array(CROSSING, dtype=bool),
        log_evidence=np.zeros(len(IDS)),
        is_impossible=np.zeros(len(IDS), dtype=bool),
    )
    return replace(result, **changes)


def without_truth() -> Result:
    nothing = np.zeros(len(IDS), dtype=int)
    return a_result(true_lane=nothing, is_crossing=nothing.astype(bool))


def without_tentative() -> Result:
    return a_result(tentative=None)


def without_bonus(**changes: Any) -> Result:
    config = {"parameters": {"bonus_value": 0.0, "sigma1": 0.3}, "graph": "sensor_failure"}
    return a_result(**{"config": config, "directory": Path("results/no_bonus"), **changes})


def long_drive(n_frames: int) -> Result:
    """One belief for every frame, so that any average of it is known."""
    lane = np.full(n_frames, 2)
    belief = np.tile([0.1, 0.7, 0.2], (n_frames, 1))
    belief[1::2] = [0.3, 0.5, 0.2]
    return a_result(
        frame_id=np.arange(n_frames) + 5,
        time_s=(np.arange(n_frames) + 5) / 10,
        marginals={"Lane": belief},
        tentative=belief,
        assigned_lane=lane,
        true_lane=lane,
        is_crossing=np.zeros(n_frames, dtype=bool),
        log_evidence=np.zeros(n_frames),
        is_impossible=np.zeros(n_frames, dtype=bool),
    )


def axes_called(figure: Any, name: str) -> list[Any]:
    return [ax for ax in figure.axes if ax.get_label() == name]


def texts(figure: Any) -> list[str]:
    return [t.get_text() for t in (*figure.texts, *(t for ax in figure.axes for t in ax.texts))]


def legend_labels(holder: Any) -> list[str]:
    return [t.get_text() for t in holder.get_texts()]
