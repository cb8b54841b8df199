"""Lane labels of a recording that nobody annotated, and the segments in which they are not sure.

The experiment is run smoothed, and an estimated lane width comes from all frames. The labels are
the most probable path through the smoothed beliefs over lanes (Viterbi's recursion on posterior
probabilities: Fariselli, Martelli and Casadio 2005). It differs from the most probable lane of each
frame in that a lane change happens once, also while the belief hovers about a half.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.loading import load_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.result import Result, score
from egolane_pgm.runs import Input, run_input
from egolane_pgm.tools.files import plain, write_text
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, joined, lane_truth

#: Labels with a smaller probability are not sure.
BELOW = 0.99

#: The weight of a path that changes lane once more, per frame in which it could. Between .1 and
#: .001 the labels of the paper's recordings hardly differ.
CHANGE_WEIGHT = 0.01

#: Without a position in the lane, frames within this time of a lane change are crossing, seconds.
BESIDE_S = 1.0

#: Segments that are closer to each other are one, seconds.
JOIN_S = 1.0


@dataclass(frozen=True, repr=False, eq=False)
class Labels:
    """The labels of T frames.

    - run: the experiment, smoothed.
    - frames: a row per frame, by `frame_id`: `lane`, 1 (leftmost) to n; `confidence`, the smoothed
      probability of the label, while the car crosses a line that of both lanes; `is_crossing`; and
      `time_s`.
    - below: labels with a smaller confidence are not sure.

    >>> import egolane_pgm as ego
    >>> labels = ego.label("zero_label", overrides={"recording.frames": [0, 300]})
    >>> labels.frames["lane"].value_counts().to_dict()
    {1: 197, 2: 70, 3: 33}
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
        """A row per segment whose labels are not sure: `first_frame`, `last_frame`, `first_s`,
        `last_s`, `frames` and `lowest_confidence`."""
        ids, time_s = self.frames.index, self.frames["time_s"].to_numpy()
        confidence = self.frames["confidence"].to_numpy()
        rows = [
            (ids[a], ids[b - 1], time_s[a], time_s[b - 1], b - a, confidence[a:b].min())
            for a, b in joined(confidence < self.below, time_s, JOIN_S)
        ]
        names = ["first_frame", "last_frame", "first_s", "last_s", "frames", "lowest_confidence"]
        return pd.DataFrame(rows, columns=names)

    @property
    def document(self) -> dict[str, Any]:
        """The content of the file of `egolane label --json`."""
        return {
            "name": self.run.experiment.name,
            "n_lanes": self.run.experiment.n_lanes,
            "frames": len(self.frames),
            "below": self.below,
            "segments": self.segments().to_dict("records"),
            "warnings": self.notes,
            "scores": self.run.scores,
        }

    def __repr__(self) -> str:
        unsure, n = self.segments()["frames"], len(self.frames)
        changes = np.count_nonzero(np.diff(self.frames["lane"]))
        said = f"{self.run.experiment.name!r}: {n} frames, {self.run.experiment.n_lanes} lanes"
        said += (
            f", {changes} lane changes, {len(unsure)} segments not sure ({unsure.sum() / n:.1%})"
        )
        if self.run.truth is not None:
            said += f", accuracy {self.run.scores['model']['accuracy']:.4f}"
        return f"Labels({said})"

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The segments whose labels are not sure; see `Result.to_text`."""
        from egolane_pgm.views.tables import Table, page

        known = "labels know the whole recording: for the frames themselves, not for a causal score"
        table = self.segments().round(4)
        parts: list[Any] = [f"{repr(self)[7:-1]}\n{known}"]
        if len(table):
            parts += [f"segments with labels below {self.below:g}:"]
            parts += [Table(list(table), table.astype(str).to_numpy().tolist())]
        return page(parts, style, wide)

    def save(self, directory: str | os.PathLike[str]) -> Path:
        """Write a result directory, as a run's, with labels.txt (`frame;lane;crossing`, a
        ground-truth file as `run` reads it) and segments.csv in it.

        An older result of that name is replaced. Raises InputError if the directory contains
        anything else, or cannot be written.
        """
        place = self.run.save(directory)
        write_ground_truth(place / "labels.txt", self.truth)
        write_text(place / "segments.csv", self.segments().to_csv(index=False))
        return place


def label_input(given: Input, below: float = BELOW) -> Labels:
    """Label the recording of an experiment, which is run smoothed.

    - below: labels with a smaller confidence are not sure.

    Raises InputError for a threshold that is no probability, and for several drives.
    """
    if not 0 <= below <= 1:
        raise InputError(f"below: {below} is not a probability (0 to 1)")
    changes = {"filter": "smoothed", "lag": None, "min_confidence": 0.0}
    smoothed = load_experiment(given.experiment, changes)
    run = run_input(given._replace(experiment=smoothed))
    if len(run.lines) > 1:
        raise InputError(f"{run.name}: has {len(run.lines)} drives; label them one by one")
    belief, time_s = run.node("Lane"), run.frames["time_s"].to_numpy()
    lane = lane_path(belief)
    crossing = run.frames.get("line_crossing_probability")
    on_line = None if crossing is None else crossing.to_numpy()
    possible = crossed_lanes(lane, time_s, belief.shape[1], on_line)
    frames = pd.DataFrame(
        {
            "lane": lane,
            "is_crossing": possible.sum(axis=1) > 1,
            "confidence": (belief * possible).sum(axis=1),
            "time_s": time_s,
        },
        index=run.frames.index,
    )
    answered = run.frames.assign(assigned_lane=lane)
    scores = plain(score(answered, run.frame_rate))
    return Labels(replace(run, frames=answered, scores=scores), frames, below)


def lane_path(belief: FloatArray) -> IntArray:
    """(T,): the lanes, from 1, of the path with the largest product of beliefs (T, n), in which
    each step of k lanes weighs CHANGE_WEIGHT ** k."""
    n_frames, n_lanes = belief.shape
    lanes = np.arange(n_lanes)
    step = np.log(CHANGE_WEIGHT) * np.abs(lanes[:, None] - lanes)
    path, index = np.zeros(n_frames, dtype=np.int64), np.zeros(n_frames, dtype=np.int64)
    with np.errstate(divide="ignore"):
        best_path(np.zeros((1, n_lanes)), step[None], np.log(belief), index, path)
    return path + 1


def crossed_lanes(
    lane: IntArray, time_s: FloatArray, n_lanes: int, on_line: FloatArray | None
) -> BoolArray:
    """(T, n): the lanes that the car is in: one, or while it crosses the line between two both.

    - lane, time_s (T,): the labels, and seconds.
    - on_line (T,): the line crossing probability; None if the graph has no position in the lane.

    Crossing are the frames in a row around a change of the label in which the car is more probably
    than not on a line, or, without `on_line`, those within BESIDE_S; and the two between which the
    label changes. A change while nothing was recorded has none.
    """
    n_frames = len(lane)
    possible = lane[:, None] == np.arange(1, n_lanes + 1)
    step = np.diff(time_s)
    is_next = np.append((step >= 0) & (step <= BESIDE_S), False)
    for t in np.flatnonzero((np.diff(lane) != 0) & is_next[:-1]):
        before, after = int(lane[t]), int(lane[t + 1])
        near = np.abs(time_s - (time_s[t] + time_s[t + 1]) / 2) <= BESIDE_S
        if on_line is not None:
            near = on_line > 0.5
        start, stop = t, t + 1
        while start > 0 and near[start - 1] and lane[start - 1] == before and is_next[start - 1]:
            start -= 1
        while stop + 1 < n_frames and near[stop + 1] and lane[stop + 1] == after and is_next[stop]:
            stop += 1
        possible[start : stop + 1, min(before, after) - 1 : max(before, after)] = True
    return np.asarray(possible)
