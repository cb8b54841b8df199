"""Lane labels of a recording that nobody annotated, and which of them a human should look at.

A labeller is not in a hurry, so it knows the whole recording: the beliefs are smoothed, and where
the evidence rule estimates a lane width, it does so from all frames.

The labels are the most probable path through the smoothed beliefs over lanes (Viterbi's recursion
on posterior probabilities: Fariselli, Martelli and Casadio 2005). It differs from the most probable
lane of each frame in that a lane change happens once, also where the car stays on the line for
seconds and the belief hovers about a half. The most probable path of the joint state
(`inference.viterbi`) is the second opinion: one story out of many, it may hold a lane for minutes
that the belief hardly gives a chance. Where it says another lane, the review list tells.

The confidence of a frame is the smoothed probability of its label.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.drive import ONE_DRIVE, Recorded, may_fit
from egolane_pgm.evidence.line_geometry.habits import is_placed
from egolane_pgm.evidence.line_geometry.lane_width import lane_width
from egolane_pgm.evidence.line_geometry.model import LANE_M
from egolane_pgm.evidence.lines_beside import own_lane_m
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.inference.events import crossing_probability
from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.recordings import check_one_drive
from egolane_pgm.recordings.source import Read
from egolane_pgm.results import SCHEMA_VERSION, Result, staged, write_result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.probabilistic import answers_curve
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.tools.files import plain
from egolane_pgm.types import (
    NOTE,
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    LaneTruth,
    LineLog,
    joined,
    not_one_of,
    runs_of,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: Frames whose label has a smaller probability are looked at.
BELOW = 0.99

#: The weight of a path that changes lane once more, per frame in which it could. Between .1 and
#: .001 the labels of the paper's recordings hardly differ.
CHANGE_WEIGHT = 0.01

#: Without a position in the lane, frames within this time of a lane change are crossing, seconds.
BESIDE_S = 1.0

#: Stretches that are closer to each other are looked at together, seconds.
JOIN_S = 1.0

#: What holds in this share of a stretch's frames is said of it.
SOME = 0.25

#: A lane that reaches this probability in a stretch is in question there.
QUESTIONED = 0.05

#: A note says that lines of the own lane are missing while others are seen if that is so in this
#: share of the frames. It is on each drive of the paper's Italian multi-lane detector (.42 to .69;
#: ten recordings and the benchmark's public part), and on no other (.26; simple ones .14).
HOLED = 0.3

#: Shares of the frames, the surest ones, whose accuracy is reported.
SHARES = (1.0, 0.98, 0.95, 0.9)


@dataclass(frozen=True)
class Stretch:
    """Frames in a row that a human should look at.

    - start, stop: the row of its first frame, and the one after its last.
    - first, last: frame ids. first_s, last_s: seconds.
    - lanes: those that are in question.
    - lowest: the lowest confidence.
    - expected_wrong: the sum of what the confidences lack to one: how many of the frames are wrong
      if the model is right.
    - why: what makes them hard, where that can be said.
    """

    start: int
    stop: int
    first: int
    last: int
    first_s: float
    last_s: float
    lanes: tuple[int, ...]
    lowest: float
    expected_wrong: float
    why: str

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True, repr=False, eq=False)
class Labels:
    """The labels of T frames, and which of them a human should look at.

    - run: the experiment, smoothed.
    - lane (T,): 1 (leftmost) to n.
    - possible (T, n): marks the label's lane and, while the car crosses a line, the lane on the
      line's other side.
    - story (T,): the lane on the most probable path of the joint state.
    - below: frames with less confidence are reviewed.

    >>> import egolane_pgm as ego
    >>> labels = ego.label(experiment="zero_label", overrides={"recording.frames": [0, 300]})
    >>> labels.to_pandas()["lane"].value_counts().to_dict()
    {1: 197, 2: 70, 3: 33}
    """

    run: Result
    lane: IntArray
    possible: BoolArray
    story: IntArray
    below: float

    def __len__(self) -> int:
        return len(self.lane)

    @property
    def frame_id(self) -> IntArray:
        """(T,)."""
        return self.run.frame_id

    @property
    def lines(self) -> LineLog:
        """Of T frames."""
        assert self.run.lines is not None
        return self.run.lines

    @property
    def is_crossing(self) -> BoolArray:
        """(T,): marks frames in which the car crosses a line on its way to another lane."""
        return np.asarray(self.possible.sum(axis=1) > 1)

    @cached_property
    def confidence(self) -> FloatArray:
        """(T,): the smoothed probability of the label."""
        return self.run.beliefs.lane[np.arange(len(self)), self.lane - 1]

    @cached_property
    def on_line(self) -> FloatArray | None:
        """(T,): the probability that the car is on a line; None where the graph cannot tell."""
        return crossing_probability(self.run.beliefs.marginals)

    @property
    def is_doubtful(self) -> BoolArray:
        """(T,): marks frames whose confidence is too low. While the car crosses a line both lanes
        are right, so that their probabilities count together."""
        return np.asarray((self.run.beliefs.lane * self.possible).sum(axis=1) < self.below)

    @property
    def truth(self) -> LaneTruth:
        """The labels as what a ground-truth file says."""
        return LaneTruth(self.frame_id, self.lane, self.is_crossing, "labels")

    @cached_property
    def review(self) -> tuple[Stretch, ...]:
        """The stretches that a human should look at, in their order."""
        time_s = self.run.time_s
        return tuple(self.stretch(a, b) for a, b in joined(self.is_doubtful, time_s, JOIN_S))

    @property
    def is_reviewed(self) -> BoolArray:
        """(T,): marks the frames of these stretches."""
        found = np.zeros(len(self), dtype=bool)
        for each in self.review:
            found[each.start : each.stop] = True
        return found

    @property
    def worst(self) -> list[Stretch]:
        """The stretches, those first in which most frames are expected to be wrong."""
        return sorted(self.review, key=lambda each: -each.expected_wrong)

    def stretch(self, start: int, stop: int) -> Stretch:
        """What there is to say about the frames in some rows."""
        log, rows = self.lines, slice(start, stop)
        belief, confidence = self.run.beliefs.lane[rows], self.confidence[rows]
        questioned = belief.max(axis=0) >= QUESTIONED
        questioned[self.lane[rows] - 1] = True
        questioned[np.argsort(belief[np.argmin(confidence)])[-2:]] = True
        return Stretch(
            start,
            stop,
            int(log.frame_id[start]),
            int(log.frame_id[stop - 1]),
            float(log.time_s[start]),
            float(log.time_s[stop - 1]),
            tuple(int(k) + 1 for k in np.flatnonzero(questioned)),
            float(confidence.min()),
            float((1 - confidence).sum()),
            "; ".join(_reasons(self, rows)),
        )

    def stretches(self, marked: BoolArray) -> list[Stretch]:
        """The runs of marked frames, (T,)."""
        return [self.stretch(a, b) for a, b in runs_of(marked)]

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.run.experiment.name

    @cached_property
    def scores(self) -> dict[str, Any]:
        """See `label_scores`; empty without ground truth."""
        return label_scores(self)

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return self.run.notes

    @property
    def document(self) -> dict[str, Any]:
        """What `egolane label --json` writes."""
        from egolane_pgm.views.label_tables import review_row

        return {
            "schema_version": SCHEMA_VERSION,
            "name": self.name,
            "n_lanes": self.run.experiment.n_lanes,
            "frames": len(self),
            "below": self.below,
            "reviewed": float(self.is_reviewed.mean()),
            "review": [review_row(each) for each in self.review],
            "doubted": [review_row(each) for each in self.stretches(doubted(self))],
            "warnings": self.notes,
            "scores": self.scores,
        }

    # --- shown; pandas, xarray and matplotlib are imported when they are asked for --------------

    def __repr__(self) -> str:
        from egolane_pgm.views.label_tables import label_title

        return f"Labels({label_title(self)})"

    def _repr_html_(self) -> str:
        from egolane_pgm.views import label_tables, shown

        rows = label_tables.review_rows(self.review)
        return shown.html_table(label_tables.label_title(self), *rows, self.notes)

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The stretches to review, and the scores; see `Result.to_text`."""
        from egolane_pgm.views.label_tables import label_parts
        from egolane_pgm.views.tables import page

        return page(label_parts(self), style, wide)

    def to_pandas(self, table: str = "frames") -> pd.DataFrame:
        """A row per frame; the index is `frame_id`.

        Columns: `lane`, `confidence` (the smoothed probability of the label), `is_crossing`,
        `is_reviewed`, `time_s`, the belief in each lane (`Lane=1`, ...), and with ground truth
        `true_lane`, missing where nobody annotated the frame.

        - table: "review" for a row per stretch of frames that a human should look at:
          `first_frame`, `last_frame`, `first_s`, `last_s`, `frames`, `lanes` (in question),
          `lowest_confidence`, `expected_wrong` (frames, if the model is right) and `why`;
          "doubted" for the same where a sure label contradicts the annotation.

        Raises InputError for another table.
        """
        from egolane_pgm.views.label_tables import label_frame

        if table not in ("frames", "review", "doubted"):
            raise InputError(f"table: {not_one_of(table, ('frames', 'review', 'doubted'))}")
        return label_frame(self, table)

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        from egolane_pgm.views.shown import as_dataset

        return as_dataset(self.to_pandas())

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the lines, the belief with the labels, and the confidence.

        - first, last: frame ids, both included; by default the stretch of the review list in which
          most frames are expected to be wrong, or the whole recording where there is none.

        Raises InputError for a range without frames.
        """
        from egolane_pgm.views.review import review_figure
        from egolane_pgm.views.style import inline_figure

        ids, worst = self.frame_id, self.worst[:1]
        if first is None and last is None and worst:
            first, last = worst[0].first, worst[0].last
        low, high = ids[0] if first is None else first, ids[-1] if last is None else last
        return inline_figure(lambda: review_figure(self, int(low), int(high)))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write a result directory, as a run's, with the labels in it:

        labels.txt: `frame;lane;crossing`, a ground-truth file as `run` reads it. labels.csv: the
        same with time_s, confidence and whether the frame is on the review list. review.csv: that
        list. doubted.csv: with ground truth, where sure labels contradict it.
        figures/review_*.png: the worst stretches.

        - figures: whether pictures are drawn.

        An older result of that name is replaced; files of your own in it stay. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        from egolane_pgm.views.label_tables import write_labels

        with staged(Path(directory)) as folder:
            write_result(folder, self.run)
            write_labels(folder, self)
            if figures:
                from egolane_pgm.views.review import draw_review

                draw_review(self, folder / "figures")
        return Path(directory)


def label_experiment(
    experiment: Experiment,
    below: float = BELOW,
    *,
    recorded: Recorded | None = None,
    read: Read | None = None,
) -> Labels:
    """Label the recording of an experiment, which is run smoothed.

    - below: frames with less confidence are put on the review list.
    - recorded: its recording, where it was read already. read: lines and lanes in memory.

    Raises InputError as `run_experiment` does, and for a threshold that is no probability.
    """
    if not 0 <= below <= 1:
        raise InputError(f"below: {below} is not a probability (0 to 1)")
    smoothed = load_experiment(
        experiment,
        {"filter": "smoothed", "lag": None, "decode": "marginal", "unassigned_below": 0.0},
    )
    run = run_experiment(smoothed, recorded=recorded, read=read)
    assert run.lines is not None
    assert run.evidence is not None
    check_one_drive(run.lines, ONE_DRIVE)
    if not len(run.beliefs):
        raise InputError(f"{run.lines.source}: has no frames to label")
    beliefs, log = run.beliefs, run.lines
    lane = lane_path(beliefs.lane)
    possible = crossed_lanes(lane, log.time_s, beliefs.marginals)
    story = viterbi(run.model.compiled, run.evidence, frame_id=log.frame_id).lane
    scores = dict(run.scores)
    if run.truth is not None:
        k, rate = run.scored, run.experiment.recording.frame_rate
        scores["model"] = plain(
            score_with_intervals(beliefs.lane[k], run.truth, rate, assigned=lane[k])
        )
    said = {**run.run, "warnings": [*run.notes, *filter(None, [note_of_holes(log)])]}
    run = replace(run, assigned_lane=lane, scores=scores, run=said)
    return Labels(run, lane, possible, story, below)


def note_of_holes(log: LineLog) -> str | None:
    """A note on a detector that misses lines of the own lane in HOLED of the frames: three valid
    lines or more are seen, and the nearest ones on the left and on the right are more than a lane
    and a half apart, or one of them is not there. None for any other."""
    is_line = log.is_valid & is_placed(log.offset_m)
    is_wide = own_lane_m(replace(log, is_valid=is_line)) > 1.5 * lane_width(log, LANE_M).width_m
    share = float((is_wide & (is_line.sum(axis=1) >= 3)).mean())
    if share < HOLED:
        return None
    return (
        f"{NOTE}{log.source}: in {share:.0%} of the frames a line of the own lane is missing while"
        " three others or more are seen, as by multi-lane detectors: their labels are less often"
        " right (.989 on the paper's run 5; on a recording not seen before .956 of those that"
        " need no review)"
    )


def lane_path(belief: FloatArray) -> IntArray:
    """(T,): the lanes, from 1, of the path with the largest product of beliefs (T, n), in which
    each step of k lanes weighs CHANGE_WEIGHT ** k."""
    n_frames, n_lanes = belief.shape
    lanes = np.arange(n_lanes)
    step = np.log(CHANGE_WEIGHT) * np.abs(lanes[:, None] - lanes)
    path = np.zeros(n_frames, dtype=np.int64)
    if n_frames:
        with np.errstate(divide="ignore"):
            log_belief = np.log(belief)
        index = np.zeros(n_frames, dtype=np.int64)
        best_path(np.zeros((1, n_lanes)), step[None], log_belief, index, path)
    return path + 1


def crossed_lanes(
    lane: IntArray, time_s: FloatArray, marginals: Mapping[str, FloatArray]
) -> BoolArray:
    """(T, n): the lanes that the car is in: one, or two in the frames in which it crosses the line
    between them on a lane change (more where it jumps over lanes).

    - lane, time_s (T,): the labels, and seconds.
    - marginals: the beliefs over Lane (T, n) and, where the graph has it, RoadPosition (T, n times
      cells).

    These are the frames in a row around a change of the label in which the car is more probably
    than not on a line (`inference.events.crossing_probability`); where the graph has no place in
    the lane, those within BESIDE_S. The two frames between which the label changes belong to them
    in any case. A change while nothing was recorded has none.
    """
    n_frames, n_lanes = marginals["Lane"].shape
    on_line = crossing_probability(marginals)
    possible = lane[:, None] == np.arange(1, n_lanes + 1)
    step = np.diff(time_s)
    is_next = np.append((step >= 0) & (step <= BESIDE_S), False)
    for t in np.flatnonzero(np.diff(lane) != 0):
        if not is_next[t]:
            continue
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


def _reasons(labels: Labels, rows: slice) -> list[str]:
    """What makes some frames hard, a few words each."""
    run, log = labels.run, labels.lines
    marginals, n_frames = run.beliefs.marginals, len(labels)
    found = []
    if rows.start == 0:
        found.append("the recording begins")
    if rows.stop == n_frames:
        found.append("the recording ends")
    # From the frame before to the one after.
    gaps = np.diff(log.frame_id[max(rows.start - 1, 0) : rows.stop + 1]) - 1
    missing = int(gaps.sum() + log.is_missing[rows].sum())
    if missing >= SOME * (rows.stop - rows.start):
        found.append(f"{missing} frames were not recorded")
    blind = float((~log.is_valid[rows].any(axis=1)).mean())
    if blind >= SOME:
        found.append(f"no valid line in {blind:.0%} of the frames")
    sensor = run.model.compiled.values.get("SensorState", ())
    if "OK" in sensor:
        is_ok = float(marginals["SensorState"][rows, list(sensor).index("OK")].mean())
        if is_ok < 0.5:
            found.append(f"the sensor is believed to work with probability {is_ok:.2f} only")
    if run.beliefs.is_impossible[rows].any():
        found.append("the model holds the evidence of some frames for impossible")
    on_line = labels.on_line
    if on_line is not None and on_line[rows].mean() >= 0.5:
        found.append("the car is on a line")
    other = labels.story[rows] != labels.lane[rows]
    if other.mean() >= SOME:
        lanes = " and ".join(map(str, np.unique(labels.story[rows][other])))
        found.append(f"the most probable single story is in lane {lanes} for {other.sum()} frames")
    return found


def label_scores(labels: Labels) -> dict[str, Any]:
    """How good the labels are, where there is ground truth; empty without.

    - frames_scored: annotated frames that are not crossing; frames whose annotation an experiment
      does not trust (`tuning.never_fit`) do not count.
    - surest: the accuracy of each of SHARES of them, those with the highest confidence.
    - reviewed: the share of them on the review list.
    - unreviewed: the accuracy of those that are neither on it nor labelled as crossing.
    - wrong_unreviewed: how many of these are wrong.
    - crossing_precision, crossing_recall: of the labelled crossing frames against the annotated.

    A score without a frame is None.
    """
    run = labels.run
    truth, rows, tuning = run.truth, run.scored, run.experiment.tuning
    if truth is None:
        return {}
    trusted = may_fit(truth.frame_id, () if tuning is None else tuning.never_fit)
    keep = trusted & ~truth.is_crossing
    is_right, crossing = labels.lane[rows] == truth.lane, labels.is_crossing[rows]
    curve = answers_curve(labels.confidence[rows][keep], is_right[keep])
    reviewed = labels.is_reviewed[rows]
    alone = keep & ~reviewed & ~crossing
    both = (crossing & truth.is_crossing & trusted).sum()
    return {
        "frames_scored": int(keep.sum()),
        "trusted_only": not bool(trusted.all()),
        "surest": {f"{share:g}": plain(curve.accuracy_of_surest(share)) for share in SHARES},
        "reviewed": _share((reviewed & keep).sum(), keep.sum()),
        "unreviewed": _share((is_right & alone).sum(), alone.sum()),
        "wrong_unreviewed": int(np.count_nonzero(~is_right & alone)),
        "crossing_precision": _share(both, (crossing & trusted).sum()),
        "crossing_recall": _share(both, (truth.is_crossing & trusted).sum()),
    }


def _share(part: Any, whole: Any) -> float | None:
    return float(part / whole) if whole else None


def doubted(labels: Labels) -> BoolArray:
    """(T,): marks frames in which a sure label contradicts the annotation, and neither says that
    the car is crossing a line. Sure is one that is not below the threshold of the review."""
    found = np.zeros(len(labels), dtype=bool)
    truth, rows = labels.run.truth, labels.run.scored
    if truth is not None:
        found[rows] = (labels.lane[rows] != truth.lane) & ~truth.is_crossing
    return found & (labels.confidence >= labels.below) & ~labels.is_crossing
