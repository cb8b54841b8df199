"""Lane labels of a recording without annotation, and the segments in which they are uncertain.

The experiment is run smoothed, and an estimated lane width comes from all frames. The labels are
the most probable path through the smoothed posteriors (Viterbi's recursion on posterior
probabilities: Fariselli, Martelli and Casadio 2005). Unlike the most probable lane of each frame,
the path changes lane once while the posterior hovers about a half.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.loading import load_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.result import Result, score
from egolane_pgm.runs import Input, run_input
from egolane_pgm.tools.files import to_jsonable, write_text
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, lane_truth, merged_runs

#: Labels with a smaller probability are uncertain.
BELOW = 0.99

#: The weight of each lane change of a path. From .1 to .001 the labels of the paper's recordings
#: hardly differ.
CHANGE_WEIGHT = 0.01

#: Uncertain segments this close to each other are one; and without a position in the lane, frames
#: this close to a lane change are crossing. Seconds.
NEAR_S = 1.0


@dataclass(frozen=True, repr=False, eq=False)
class Labels:
    """The labels of T frames.

    - run: the result of the smoothed experiment.
    - frames: a row per frame, by `frame_id`: `lane`, 1 (leftmost) to n; `is_crossing`; `time_s`;
      `confidence`, the smoothed probability of the label, of both lanes during a crossing.
    - below: labels with a smaller confidence are uncertain.

    >>> import egolane_pgm as ego
    >>> labels = ego.label("zero_label", overrides={"recording.frames": [0, 300]})
    >>> labels.frames["lane"].value_counts().to_dict()
    {1: 198, 2: 69, 3: 33}
    """

    run: Result
    frames: pd.DataFrame
    below: float

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return self.run.notes

    @property
    def truth(self) -> pd.DataFrame:
        """The labels as ground truth: true_lane and is_crossing."""
        frames = self.frames
        return lane_truth(frames.index, frames["lane"], frames["is_crossing"], "labels")

    def segments(self) -> pd.DataFrame:
        """A row per uncertain segment: frame ids, seconds, frames and the lowest confidence."""
        ids = self.frames.index
        time_s = self.frames["time_s"].to_numpy()
        confidence = self.frames["confidence"].to_numpy()
        rows = [
            (ids[a], ids[b - 1], time_s[a], time_s[b - 1], b - a, confidence[a:b].min())
            for a, b in merged_runs(confidence < self.below, time_s, NEAR_S)
        ]
        names = ["first_frame", "last_frame", "first_s", "last_s", "frames", "lowest_confidence"]
        return pd.DataFrame(rows, columns=names)

    def __repr__(self) -> str:
        unsure = self.segments()["frames"]
        n = len(self.frames)
        changes = np.count_nonzero(np.diff(self.frames["lane"]))
        text = (
            f"{self.run.name!r}: {n} frames, {self.run.n_lanes} lanes, {changes} lane"
            f" changes, {len(unsure)} uncertain segments ({unsure.sum() / n:.1%})"
        )
        if self.run.truth is not None:
            text += f", accuracy {self.run.scores['model']['accuracy']:.4f}"
        return f"Labels({text})"

    def to_text(self) -> str:
        """The uncertain segments, as `egolane label` prints them."""
        from egolane_pgm.views.tables import page, table

        note = "labels use the whole recording: do not score a causal filter's past with them"
        parts: list[Any] = [f"{repr(self)[7:-1]}\n{note}"]
        if len(segments := self.segments()):
            parts += [f"segments with labels below {self.below:g}:"]
            parts += [table(segments.set_index("first_frame"), {"first_s": 1, "last_s": 1})]
        return page(parts)

    def save(self, directory: str | os.PathLike[str]) -> Path:
        """Write a result directory, with labels.txt (a ground-truth file) and segments.csv in it.

        An older result there is replaced. Raises InputError if the directory contains anything
        else, or cannot be written.
        """
        place = self.run.save(directory)
        write_ground_truth(place / "labels.txt", self.truth)
        write_text(place / "segments.csv", self.segments().to_csv(index=False))
        return place


def label_input(given: Input, below: float = BELOW) -> Labels:
    """Label the recording of an experiment, which is run smoothed.

    Raises InputError for a threshold outside 0 to 1, and for several drives.
    """
    if not 0 <= below <= 1:
        raise InputError(f"below: {below} is not a probability (0 to 1)")
    changes = {"filter": "smoothed", "lag": None, "min_confidence": 0.0}
    run = run_input(given._replace(experiment=load_experiment(given.experiment, changes)))
    if len(run.lines) > 1:
        raise InputError(f"{run.name}: has {len(run.lines)} drives; label them one by one")
    belief = run.node("Lane")
    time_s = run.frames["time_s"].to_numpy()
    lane = lane_path(belief)
    on_line = run.frames.get("line_crossing_probability")
    possible = crossed_lanes(lane, time_s, belief.shape[1], on_line)
    frames = pd.DataFrame({"lane": lane, "is_crossing": possible.sum(axis=1) > 1}, run.frames.index)
    frames = frames.assign(confidence=(belief * possible).sum(axis=1), time_s=time_s)
    answered = run.frames.assign(assigned_lane=lane)
    scores = to_jsonable(score(answered, run.frame_rate))
    return Labels(replace(run, frames=answered, scores=scores), frames, below)


def lane_path(belief: FloatArray) -> IntArray:
    """The lanes (T,), from 1, of the path with the largest product of posteriors (T, n).

    Each step of k lanes weighs CHANGE_WEIGHT ** k.
    """
    n_frames, n_lanes = belief.shape
    lanes = np.arange(n_lanes)
    step = np.log(CHANGE_WEIGHT) * np.abs(lanes[:, None] - lanes)
    path = np.zeros(n_frames, dtype=np.int64)
    index = np.zeros_like(path)
    with np.errstate(divide="ignore"):
        best_path(np.zeros((1, n_lanes)), step[None], np.log(belief), index, path)
    return path + 1


def crossed_lanes(
    lane: IntArray, time_s: FloatArray, n_lanes: int, on_line: ArrayLike | None
) -> BoolArray:
    """Mark the lanes that the car occupies (T, n): one, or several during a crossing.

    - lane, time_s (T,): labels and seconds.
    - on_line (T,): the line crossing probability; None if the graph has no position in the lane.

    A crossing is the run of frames around a change of the label with an `on_line` above 0.5, or,
    without `on_line`, within NEAR_S; at least the two frames of the change. A change over a gap in
    the recording has no crossing.
    """
    possible: BoolArray = lane[:, None] == np.arange(1, n_lanes + 1)
    step = np.diff(time_s)
    is_gap = (step < 0) | (step > NEAR_S)
    for t in np.flatnonzero((np.diff(lane) != 0) & ~is_gap):
        if on_line is None:
            near = np.abs(time_s - (time_s[t] + time_s[t + 1]) / 2) <= NEAR_S
        else:
            near = np.asarray(on_line) > 0.5
        # The nearest frame on either side that is not part of the crossing.
        out = np.flatnonzero(~near[:t] | (lane[:t] != lane[t]) | is_gap[:t])
        start = out[-1] + 1 if out.size else 0
        k = t + 2
        out = np.flatnonzero(~near[k:] | (lane[k:] != lane[t + 1]) | is_gap[t + 1 :])
        stop = k + out[0] if out.size else len(lane)
        low, high = sorted(lane[t : t + 2])
        possible[start:stop, low - 1 : high] = True
    return possible
