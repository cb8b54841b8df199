"""Labels for free: `label` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.api.runs import choose
from egolane_pgm.experiment import Given, Overrides, experiments_folder
from egolane_pgm.labelling import (
    BELOW,
    Labels,
    Stretch,
    doubted,
    label_experiment,
    label_scores,
)
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.report import shown
from egolane_pgm.report.tables import score_text
from egolane_pgm.results import Result, staged, write_result
from egolane_pgm.tools.files import as_csv, write_text
from egolane_pgm.types import InputError, LaneTruth

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: The experiment that labels a recording where none is named.
EXPERIMENT = "zero_label.yaml"


@dataclass(frozen=True, repr=False, eq=False)
class LabelResult:
    """The lane labels of a recording, and which of them a human should look at.

    - labels: of T frames, beside the smoothed run that they come from.
    - scores: see `egolane_pgm.labelling.label_scores`; empty without ground truth.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "zero_label.yaml"  # a simulated drive
    >>> found = ego.label(experiment=place, overrides={"recording.frames": [0, 600]})
    >>> found
    LabelResult('zero_label': 600 frames, 3 lanes, ... to review (...), accuracy 1.0000)
    >>> found.truth
    LaneTruth('labels': 600 frames, ids 0 to 599, ... crossing)
    >>> int(found.to_pandas()["lane"].loc[3])
    3
    >>> list(found.review)[:4]
    ['first_frame', 'last_frame', 'first_s', 'last_s']
    """

    labels: Labels
    scores: dict[str, Any]

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.labels.run.experiment.name

    @property
    def truth(self) -> LaneTruth:
        """The labels as what a ground-truth file says."""
        return self.labels.truth

    @property
    def run(self) -> Result:
        """The smoothed run that the labels come from; its answers are the labels."""
        return self.labels.run

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return list(self.labels.run.notes)

    def __len__(self) -> int:
        return len(self.labels)

    def __repr__(self) -> str:
        return f"LabelResult({self.title()})"

    def title(self) -> str:
        """What was found, in one line."""
        labels = self.labels
        stretches = labels.review
        seconds = labels.is_reviewed.sum() / labels.run.experiment.recording.frame_rate
        parts = [
            f"{self.name!r}: {len(self)} frames",
            f"{labels.run.experiment.n_lanes} lanes",
            f"{np.count_nonzero(np.diff(labels.lane))} lane changes",
            f"{len(stretches)} to review ({seconds:.1f} s, {labels.is_reviewed.mean():.1%})",
        ]
        if self.scores:
            parts.append(f"accuracy {score_text(self.scores['surest']['1'], 4)}")
        return ", ".join(parts)

    def _repr_html_(self) -> str:
        return shown.html_table(self.title(), *review_rows(self.labels.review), self.notes)

    def to_pandas(self) -> pd.DataFrame:
        """A row per frame; the index is `frame_id`.

        Columns: `time_s`, `lane`, `is_crossing`, `confidence` (the smoothed probability of the
        label), `is_reviewed`, the belief in each lane (`Lane=1`, ...), and with ground truth
        `true_lane`, missing where nobody annotated the frame.
        """
        import pandas as pd

        labels = self.labels
        run = labels.run
        columns: dict[str, Any] = {
            "time_s": run.time_s,
            "lane": labels.lane,
            "is_crossing": labels.is_crossing,
            "confidence": labels.confidence,
            "is_reviewed": labels.is_reviewed,
        }
        columns |= {f"Lane={k}": belief for k, belief in enumerate(run.beliefs.lane.T, start=1)}
        frame = pd.DataFrame(columns, index=pd.Index(labels.frame_id, name="frame_id"))
        truth = run.truth
        if truth is not None:
            true = pd.array(np.zeros(len(labels), dtype=np.int64), dtype="Int64")
            true[:] = pd.NA
            true[run.scored] = truth.lane
            frame["true_lane"] = true
        return frame

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    @property
    def review(self) -> pd.DataFrame:
        """A row per stretch of frames that a human should look at: `first_frame`, `last_frame`,
        `first_s`, `last_s`, `frames`, `lanes` (in question), `lowest_confidence`, `expected_wrong`
        (frames, if the model is right) and `why`."""
        return _table(self.labels.review)

    @property
    def doubted(self) -> pd.DataFrame:
        """The same for stretches in which a sure label contradicts the annotation."""
        return _table(self.labels.stretches(doubted(self.labels)))

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the lines, the belief with the labels, and the confidence.

        - first, last: frame ids, both included; by default the stretch of the review list in which
          most frames are expected to be wrong, or the whole recording where there is none.

        Raises InputError for a range without frames.
        """
        from egolane_pgm.report.review import review_figure
        from egolane_pgm.report.style import inline_figure

        ids, worst = self.labels.frame_id, self.labels.worst[:1]
        if first is None and last is None and worst:
            first, last = worst[0].first, worst[0].last
        low, high = ids[0] if first is None else first, ids[-1] if last is None else last
        return inline_figure(lambda: review_figure(self.labels, int(low), int(high)))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write a result directory, as a run's, with the labels in it:

        labels.txt: `frame;lane;crossing`, which `--ground-truth` reads. labels.csv: the same with
        time_s, confidence and whether the frame is on the review list. review.csv: that list.
        doubted.csv: with ground truth, where sure labels contradict it. figures/review_*.png: the
        worst stretches.

        - figures: whether pictures are drawn.

        An older result of that name is replaced; files of your own in it stay. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        labels, place = self.labels, Path(directory)
        with staged(place) as folder:
            write_result(folder, labels.run)
            write_ground_truth(folder / "labels.txt", labels.truth)
            write_text(folder / "labels.csv", as_csv(*_label_rows(labels)))
            write_text(folder / "review.csv", as_csv(*review_rows(labels.review)))
            if labels.run.truth is not None:
                suspect = labels.stretches(doubted(labels))
                write_text(folder / "doubted.csv", as_csv(*review_rows(suspect)))
            if figures:
                # matplotlib is imported only for figures.
                from egolane_pgm.report.review import draw_review

                draw_review(labels, folder / "figures")
        return place


def label(
    recording: str | os.PathLike[str] | None = None,
    *,
    n_lanes: int | None = None,
    experiment: Given | None = None,
    overrides: Overrides = (),
    ground_truth: str | os.PathLike[str] | None = None,
    below: float = BELOW,
    camera: str | os.PathLike[str] | None = None,
    detector: str | os.PathLike[str] | None = None,
    frame_id: str | None = None,
) -> LabelResult:
    """Label the lanes of a recording, and list the frames that a human should look at.

    - recording: a file, as `run` takes it; by default the experiment's own.
    - n_lanes: lanes of its road; by default the experiment's, where one is named.
    - experiment: what labels it; by default `experiments/zero_label.yaml`, which needs no label.
      Its filter is replaced by the smoother, and a causal lane width by that of all frames.
    - overrides: keys of the experiment that get other values.
    - ground_truth: an annotation to score the labels with, a file or "none".
    - below: frames whose label has a smaller probability are looked at.
    - camera, detector: of a video or of pictures.
    - frame_id: which number of a bag's messages is the frame id, "way_id" or "seq"; or "count",
      their order.

    Raises InputError, one line, for whatever does not fit.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "zero_label.yaml"  # a simulated drive
    >>> found = ego.label(experiment=place, overrides={"recording.frames": [0, 300]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = found.save(f"{folder}/mine", figures=False)
    ...     print((saved / "labels.txt").read_text()[:5])
    0;3;0
    """
    if experiment is None and (recording is None or n_lanes is None):
        missing = "a recording" if recording is None else "how many lanes its road has, n_lanes"
        raise InputError(f"label: needs {missing}, or an experiment that says it")
    given = experiments_folder() / EXPERIMENT if experiment is None else experiment
    chosen = choose(given, overrides, recording, ground_truth, n_lanes, frame_id, camera, detector)
    labels = label_experiment(chosen, below)
    return LabelResult(labels, label_scores(labels))


def review_rows(stretches: Sequence[Stretch]) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a review list, as text."""
    digits = {"lowest_confidence": 4}
    rows = [
        [
            f"{value:.{digits.get(name, 1)}f}" if isinstance(value, float) else str(value)
            for name, value in zip(_COLUMNS, _cells(each), strict=True)
        ]
        for each in stretches
    ]
    return list(_COLUMNS), rows


_COLUMNS = (
    "first_frame", "last_frame", "first_s", "last_s", "frames", "lanes", "lowest_confidence",
    "expected_wrong", "why",
)  # fmt: skip


def _cells(stretch: Stretch) -> tuple[int | float | str, ...]:
    lanes = " ".join(map(str, stretch.lanes))
    times = (stretch.first, stretch.last, stretch.first_s, stretch.last_s, len(stretch))
    return (*times, lanes, stretch.lowest, stretch.expected_wrong, stretch.why)


def _table(stretches: Sequence[Stretch]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([_cells(each) for each in stretches], columns=list(_COLUMNS))


def _label_rows(labels: Labels) -> tuple[list[str], list[list[str]]]:
    header = ["frame_id", "time_s", "lane", "crossing", "confidence", "review"]
    columns = (
        labels.frame_id,
        labels.run.time_s,
        labels.lane,
        labels.is_crossing.astype(int),
        labels.confidence,
        labels.is_reviewed.astype(int),
    )
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return header, [[f"{v:.6g}" if isinstance(v, float) else str(v) for v in row] for row in rows]
