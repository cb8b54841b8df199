"""The labels of a recording as tables: each frame, the stretches to review, and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.labelling import Labels, Stretch, doubted
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.tools.files import as_csv, write_text
from egolane_pgm.views.tables import Table, score_text

if TYPE_CHECKING:
    import pandas as pd

#: How many stretches of the review list are printed.
SHOWN = 10

_COLUMNS = (
    "first_frame", "last_frame", "first_s", "last_s", "frames", "lanes", "lowest_confidence",
    "expected_wrong", "why",
)  # fmt: skip


def label_title(labels: Labels) -> str:
    """What was found, in one line."""
    stretches, experiment = labels.review, labels.run.experiment
    seconds = labels.is_reviewed.sum() / experiment.recording.frame_rate
    parts = [
        f"{labels.name!r}: {len(labels)} frames",
        f"{experiment.n_lanes} lanes",
        f"{np.count_nonzero(np.diff(labels.lane))} lane changes",
        f"{len(stretches)} to review ({seconds:.1f} s, {labels.is_reviewed.mean():.1%})",
    ]
    if labels.scores:
        parts.append(f"accuracy {score_text(labels.scores['surest']['1'], 4)}")
    return ", ".join(parts)


def label_parts(labels: Labels) -> list[str | Table]:
    """What `egolane label` prints."""
    known = "labels know the whole recording: for the frames themselves, not for a causal score"
    parts: list[str | Table] = [f"{label_title(labels)}\n{known}"]
    worst, n_review = labels.worst[:SHOWN], len(labels.review)
    if worst:
        which = f"({len(worst)} of {n_review})"
        parts.append(f"to review, those first in which most frames may be wrong {which}:")
        parts.append(Table(*review_rows(worst)))
    return parts + (score_parts(labels) if labels.scores else [])


def score_parts(labels: Labels) -> list[str | Table]:
    """What the ground truth says about the labels."""
    scores = labels.scores
    which = "trusted, " if scores["trusted_only"] else ""
    rows = [
        [f"{float(share):.0%}", score_text(right, 4)] for share, right in scores["surest"].items()
    ]
    lines = [
        f"share on the review list: {score_text(scores['reviewed'])}",
        "right of those that are neither on it nor labelled as crossing:"
        f" {score_text(scores['unreviewed'], 4)} ({scores['wrong_unreviewed']} wrong)",
        f"crossing frames: precision {score_text(scores['crossing_precision'])},"
        f" recall {score_text(scores['crossing_recall'])}",
    ]
    n_doubted = len(labels.stretches(doubted(labels)))
    if n_doubted:
        lines.append(f"{n_doubted} stretch(es) in which a sure label contradicts it: doubted.csv")
    return [
        f"{scores['frames_scored']} {which}annotated frames (crossing ones are not scored):",
        Table(["surest frames", "right"], rows),
        "\n".join(lines),
    ]


def review_rows(stretches: Sequence[Stretch]) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a review list, as text."""
    digits = {"lowest_confidence": 4}
    rows = [
        [
            f"{value:.{digits.get(name, 1)}f}" if isinstance(value, float) else str(value)
            for name, value in row.items()
        ]
        for row in map(review_row, stretches)
    ]
    return list(_COLUMNS), rows


def review_row(stretch: Stretch) -> dict[str, int | float | str]:
    """A stretch of a review list, by column."""
    lanes = " ".join(map(str, stretch.lanes))
    times = (stretch.first, stretch.last, stretch.first_s, stretch.last_s, len(stretch))
    cells = (*times, lanes, stretch.lowest, stretch.expected_wrong, stretch.why)
    return dict(zip(_COLUMNS, cells, strict=True))


def label_frame(labels: Labels, table: str) -> pd.DataFrame:
    """See `Labels.to_pandas`."""
    import pandas as pd

    if table != "frames":
        some = labels.review if table == "review" else labels.stretches(doubted(labels))
        return pd.DataFrame([review_row(each) for each in some], columns=list(_COLUMNS))
    run = labels.run
    columns: dict[str, Any] = {
        "lane": labels.lane,
        "confidence": labels.confidence,
        "is_crossing": labels.is_crossing,
        "is_reviewed": labels.is_reviewed,
        "time_s": run.time_s,
    }
    columns |= {f"Lane={k}": belief for k, belief in enumerate(run.beliefs.lane.T, start=1)}
    frame = pd.DataFrame(columns, index=pd.Index(labels.frame_id, name="frame_id"))
    if run.truth is not None:
        frame["true_lane"] = pd.Series(run.truth.lane, run.truth.frame_id, dtype="Int64")
    return frame


def write_labels(folder: Path, labels: Labels) -> None:
    """Write labels.txt, labels.csv, review.csv and, with ground truth, doubted.csv."""
    write_ground_truth(folder / "labels.txt", labels.truth)
    write_text(folder / "labels.csv", as_csv(*_label_rows(labels)))
    write_text(folder / "review.csv", as_csv(*review_rows(labels.review)))
    if labels.run.truth is not None:
        suspect = labels.stretches(doubted(labels))
        write_text(folder / "doubted.csv", as_csv(*review_rows(suspect)))


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
