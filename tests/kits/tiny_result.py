"""A result of seven frames, as read, and how to read a figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.experiment import Experiment
from egolane_pgm.result import Result
from egolane_pgm.scoring.confusion import assigned_lane

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
CONFIG = {"parameters": {"bonus_value": 4.0, "sigma1": 0.3}, "graph": "sensor_failure"}
RUN = {
    "name": "tiny",
    "config": CONFIG,
    "n_lanes": 3,
    "frame_rate": 10.0,
    "values": {"Lane": ["1", "2", "3"]},
    "tuned_on": "same_frames",
    "tags": {},
    "warnings": [],
}


def frames_of(ids: Any, lane: Any, detector: Any, truth: Any, crossing: Any) -> pd.DataFrame:
    """A table of frames. truth (T,): 0 where it is unknown; detector: None for no own answer."""
    lane, known = np.asarray(lane), np.asarray(truth) > 0
    columns: dict[str, Any] = {"time_s": np.asarray(ids) / 10.0}
    columns |= {f"Lane_{k}": column for k, column in enumerate(lane.T, start=1)}
    columns["assigned_lane"] = assigned_lane(lane)
    if detector is not None:
        detector = np.asarray(detector)
        columns |= {f"detector_{k}": column for k, column in enumerate(detector.T, start=1)}
        columns["detector_lane"] = assigned_lane(detector)
    columns["log_evidence"] = np.zeros(len(lane))
    columns["is_impossible"] = np.zeros(len(lane), dtype=bool)
    columns["true_lane"] = pd.array(np.where(known, truth, 0), dtype="Int64")
    columns["is_crossing"] = pd.array(np.asarray(crossing, dtype=bool), dtype="boolean")
    frames = pd.DataFrame(columns, index=pd.Index(ids, name="frame_id"))
    frames.loc[~known, ["true_lane", "is_crossing"]] = pd.NA
    return frames


def a_result(**changes: Any) -> Result:
    frames = frames_of(IDS, MODEL, DETECTOR, TRUTH, CROSSING)
    result = Result(EXPERIMENT, frames, RUN, {}, directory=Path("results/tiny"))
    return replace(result, **changes)


def without_truth() -> Result:
    nothing = [0] * len(IDS)
    return a_result(frames=frames_of(IDS, MODEL, DETECTOR, nothing, nothing))


def without_detector() -> Result:
    return a_result(frames=frames_of(IDS, MODEL, None, TRUTH, CROSSING))


def long_drive(n_frames: int) -> Result:
    """One posterior for every second frame, so that any average of it is known."""
    lane = np.tile([0.1, 0.7, 0.2], (n_frames, 1))
    lane[1::2] = [0.3, 0.5, 0.2]
    ids, nothing = np.arange(n_frames) + 5, np.zeros(n_frames)
    return a_result(frames=frames_of(ids, lane, lane, np.full(n_frames, 2), nothing))


def texts(figure: Any) -> list[str]:
    return [t.get_text() for t in (*figure.texts, *(t for ax in figure.axes for t in ax.texts))]


def legend_labels(holder: Any) -> list[str]:
    return [t.get_text() for t in holder.get_texts()]
