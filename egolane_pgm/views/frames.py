"""Answers and ground truth of a table of frames (`Result.frames`)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from egolane_pgm.result import Result, lanes_of, truth_of
from egolane_pgm.scoring.events import is_judged
from egolane_pgm.scoring.scores import Answers
from egolane_pgm.types import BoolArray, FloatArray, InputError


def title_of(result: Result) -> str:
    """The name of a result, marked if its parameters were tuned on the frames that are scored."""
    is_in_sample = result.run["tuned_on"] in ("same_frames", "same_drive")
    return result.name + " (in-sample)" * is_in_sample


def is_known(frames: pd.DataFrame) -> BoolArray:
    """Mark the frames, (T,), that are annotated and not crossing."""
    known = frames["true_lane"].notna() & ~frames["is_crossing"].eq(True).fillna(False)
    marked: BoolArray = known.to_numpy(bool)
    return marked


def scored(frames: pd.DataFrame) -> pd.DataFrame:
    """The frames that are annotated and not crossing. Raises InputError if there are none."""
    known = frames[is_known(frames)]
    if known.empty:
        raise InputError("no annotated frame that is not crossing; run with a ground_truth")
    return known


def frames_between(frames: pd.DataFrame, first: int | None, last: int | None) -> pd.DataFrame:
    """The frames with these ids, both included. Raises InputError if there are none."""
    chosen = frames.loc[first:last]
    if chosen.empty:
        ids = frames.index
        raise InputError(
            f"frames: no frame from {first} to {last}; the result has {ids[0]} to {ids[-1]}"
        )
    return chosen


def answers(frames: pd.DataFrame) -> dict[str, Answers]:
    """The answers of "Detector", if it has some, and of "Model"; the known frames are scored."""
    lane = frames["true_lane"].fillna(0).to_numpy(np.int64)
    nodes = {"Detector": ("detector", "detector_lane"), "Model": ("Lane", "assigned_lane")}
    return {
        who: Answers(lanes_of(frames, node), lane, ~is_known(frames), frames[column].to_numpy())
        for who, (node, column) in nodes.items()
        if column in frames
    }


def true_lane(frames: pd.DataFrame) -> FloatArray:
    """The true lane (T,), NaN if not annotated."""
    lane: FloatArray = frames["true_lane"].to_numpy(np.float64, na_value=np.nan)
    return lane


def outcomes(events: pd.DataFrame, frames: pd.DataFrame) -> list[str]:
    """The outcome of each lane change of one drive: "correct", "false" or "not annotated"."""
    truth = truth_of(frames)
    if truth is None or "delay_s" not in events:
        return ["not annotated"] * len(events)
    names = np.where(is_judged(events, truth), "false", "not annotated")
    return [str(name) for name in np.where(events["delay_s"].notna(), "correct", names)]
