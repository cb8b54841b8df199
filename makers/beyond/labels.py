"""How good labels for free are: on the ten recordings, on recordings as strangers might have
written them, and where they contradict what was published."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from egolane_pgm.comparing.placing import on_recording
from egolane_pgm.drive import Recorded
from egolane_pgm.experiment import experiments_folder, load_experiment
from egolane_pgm.labelling import SHARES, Labels, label_experiment, label_scores
from egolane_pgm.paper import paper_experiment
from egolane_pgm.scoring.probabilistic import answers_curve
from egolane_pgm.types import LaneTruth, runs_of
from egolane_pgm.views.answers import DETECTOR_COLOUR, INK, MODEL_COLOUR
from egolane_pgm.views.review import review_figure
from egolane_pgm.views.style import axes_at, new_figure, write_figure
from egolane_pgm.views.tables import markdown
from tests.kits.strangers import LAST_TRUSTED, STRANGERS, Drive, paper_drive

ZERO_LABEL = experiments_folder() / "zero_label.yaml"

#: The runs of each road's detectors that follow single lines: mono and stereo, straight and curved.
SIMPLE = {"Italy": (1, 2, 3, 4), "Spain": (6, 7, 8, 9)}

HEAD = """\
# Labels for free

Made by `make beyond`, which runs `python -m makers.beyond labels --out results/beyond`. What
`egolane label RECORDING --n-lanes N` writes for the paper's ten recordings, against their
annotation. No label is used to make labels, but the model's constants were chosen with these
recordings in sight (a development score), and the labels know the whole recording (not causal).
Crossing frames are not scored; Spain (6 to 10) is scored before frame 9577.

A label is the lane on the most probable path through the smoothed beliefs, its confidence the
smoothed probability of that lane. *Review*: stretches with a confidence below .99, those of lane
changes apart (between the two lanes of a change either is right); *unreviewed*: the frames that are
neither in one nor labelled as crossing.
"""

TRIED = """\
## What was tried

With these ten annotations in sight, in this order; nothing was fitted to them. The numbers are
those of the model of that day.

1. Confidence, on the most probable lane of each frame: (a) its smoothed probability, (b) the
   smallest of these within half a second, (c) and (d) the same with 0 where the most probable path
   of the joint state is in another lane, (e) the smaller of smoothed and filtered probability, (f)
   their product. Of the surest 98 % of each of the eight simple runs, each gets .999 right. (b) and
   (d) leave 1.4 to 4.5 times as many frames below .99, (e) and (f) 4 to 17 times as many; with (c)
   some 240 right frames of run 8 are the least sure ones. The plainest, (a), is as good as any.
2. Decoding: the most probable lane of each frame (.9987 to 1 right on the simple runs, with up to
   62 changes where there are 35); the most probable path of the joint state (.9675 in run 8: for
   249 frames it tells one story that the belief hardly believes); the path through the smoothed
   beliefs (in each run as right as the first, or more so, and mostly with as many changes as there
   are). With a weight of a change of .1 or .001 one scored frame of all runs changes.
3. Crossing: the car's middle within 3, 4, 5, 6 of a lane's 16 cells of the line that it changes
   over. 4 was taken because it is half a car's width; the annotators' own habits differ (the
   median crossing lasts 1.9 s in Italy and 5.6 s in Spain).
"""


@functools.cache
def labels_of(run: int, overrides: tuple[str, ...] = ()) -> Labels:
    """The labels of one of the paper's runs."""
    zero = load_experiment(ZERO_LABEL, overrides)
    experiment = on_recording(zero, load_experiment(paper_experiment(run)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return label_experiment(experiment)


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """The page, a part at a time. only: strangers whose name has this in it."""
    given = tuple(overrides)
    yield HEAD
    yield markdown(*run_rows({run: labels_of(run, given) for run in runs}))
    yield "\n![Wrong labels against the share of frames left to a human](labels.png)"
    yield "\n## Where the labels contradict the annotation\n"
    yield SUSPECTS
    rows = [row for road, of in SIMPLE.items() if {*of} <= {*runs} for row in suspects(road, given)]
    header = ["road", "frames", "annotated", "labelled", "all sure of it", "labelled as a change"]
    yield markdown(header, rows)
    yield "\n" + VERDICT
    yield "![The end of the Spanish drive](labels_spain_9577.png)\n"
    yield TRIED
    yield STRANGE
    yield "| what is done to the recording | right | surest 98 % | review | unreviewed |"
    yield "|---|--:|--:|--:|--:|"
    simple = [run for of in SIMPLE.values() for run in of if run in runs]
    for name in STRANGERS:
        if only in name:
            yield f"| {name} | {' | '.join(stranger_cells(name, simple, given))} |"


SUSPECTS = """\
Frames that no annotator marked as crossing, in which the labels of all four simple detectors of a
road agree with each other and not with the annotation. *All sure of it*: the lowest of the four
confidences, in the frame in which it is highest. They are no four witnesses: one model reads them
all, and the lines of runs 1 and 2, 3 and 4, 6 and 7 are nearly the same.
"""

VERDICT = """\
- Italy, 7237: the annotated crossing is over at 723.6 s, but in all four recordings the line
  between lanes 2 and 3 is to the right of the car's middle until 723.9 s (.5 m, .26 m, .1 m), and
  under it in the next frames: the annotation is three or four frames early. In 9698 the line is
  under the car's middle: either lane will do.
- Spain, 9577 to the end: the annotation jumps from lane 3 to lane 1 without a crossing. Between 955
  and 961 s all lines move to the left by a lane's width; after that three or four are to the left
  of the car and hardly any to its right (below, run 6). So the car seems to have left the three
  lanes for an exit on the right, whose lanes the annotation counts anew, from 1. The labels know
  three lanes and stay in the rightmost; in lane 1 of three the car is not. The multi-lane detector
  (run 10) draws a lane around the car all the time: its labels are not sure there.
"""

STRANGE = """\
## Recordings as strangers might have written them

The same eight simple recordings, changed (see [strangers.md](strangers.md)); mean over the runs,
and the worst run. The last column is what a labeller stands or falls by: who reviews what is
listed gets the rest as right as that.
"""


def run_rows(found: dict[int, Labels]) -> tuple[list[str], list[list[str]]]:
    """The table of the ten runs."""
    header = [
        "run", "scored", "changes (annotated)", *(f"{share:.0%}" for share in SHARES), "review",
        "stretches", "s", "unreviewed", "crossing: precision", "recall",
    ]  # fmt: skip
    rows = []
    for run, labels in found.items():
        scores, truth = label_scores(labels), labels.run.truth
        assert truth is not None
        counted = slice(None) if run < 6 else truth.frame_id < LAST_TRUSTED
        mine = labels.lane[labels.run.scored][counted]
        changes = [np.count_nonzero(np.diff(lane)) for lane in (mine, truth.lane[counted])]
        rate = labels.run.experiment.recording.frame_rate
        rows.append(
            [
                str(run),
                str(scores["frames_scored"]),
                f"{changes[0]} ({changes[1]})",
                *(f"{right:.4f}" for right in scores["surest"].values()),
                f"{scores['reviewed']:.1%}",
                str(len(labels.review)),
                f"{labels.is_reviewed.sum() / rate:.0f}",
                f"{scores['unreviewed']:.4f}",
                f"{scores['crossing_precision']:.2f}",
                f"{scores['crossing_recall']:.2f}",
            ]
        )
    return header, rows


def suspects(road: str, overrides: tuple[str, ...]) -> list[list[str]]:
    """The rows of what contradicts the annotation of a road."""
    found = [labels_of(run, overrides) for run in SIMPLE[road]]
    truths = [labels.run.truth for labels in found]
    ids = functools.reduce(np.intersect1d, [truth.frame_id for truth in truths if truth])
    first = truths[0]
    assert first is not None
    there = np.searchsorted(first.frame_id, ids)
    annotated, is_crossing = first.lane[there], first.is_crossing[there]
    rows = [np.searchsorted(labels.frame_id, ids) for labels in found]
    lane = np.array([labels.lane[k] for labels, k in zip(found, rows, strict=True)])
    confidence = np.array([labels.confidence[k] for labels, k in zip(found, rows, strict=True)])
    agree = (lane == lane[0]).all(axis=0) & (lane[0] != annotated) & ~is_crossing
    told = []
    for start, stop in runs_of(agree):
        part = slice(start, stop)
        changing = [
            labels.is_crossing[k[part]].any() for labels, k in zip(found, rows, strict=True)
        ]
        told.append(
            [
                road,
                f"{ids[start]} to {ids[stop - 1]} ({stop - start})",
                str(annotated[start]),
                str(lane[0, start]),
                f"{confidence[:, part].min(axis=0).max():.3f}",
                "in all four" if all(changing) else f"in {sum(changing)} of four",
            ]
        )
    return told


def stranger_cells(name: str, runs: Sequence[int], overrides: tuple[str, ...]) -> list[str]:
    """Of each score the mean over the runs, and the worst run."""
    scores = np.array([stranger_scores(name, run, overrides) for run in runs])
    worst = [min, min, max, min]
    digits = (".3f", ".4f", ".3f", ".4f")
    return [
        f"{column.mean():{d}} ({w(column):{d}})"
        for column, w, d in zip(scores.T, worst, digits, strict=True)
    ]


def stranger_scores(name: str, run: int, overrides: tuple[str, ...]) -> tuple[float, ...]:
    """Right of all frames, right of the surest 98 %, share on the review list, right of those that
    are neither on it nor labelled as crossing."""
    confidence, right, reviewed, alone = [], [], [], []
    for drive in STRANGERS[name](paper_drive(run)):
        labels = labels_of_drive(drive, overrides)
        keep = drive.lane > 0
        confidence.append(labels.confidence[keep])
        right.append((labels.lane == drive.lane)[keep])
        reviewed.append(labels.is_reviewed[keep])
        alone.append((~labels.is_reviewed & ~labels.is_crossing)[keep])
    is_right = np.concatenate(right)
    curve = answers_curve(np.concatenate(confidence), is_right)
    left = is_right[np.concatenate(alone)]
    return (
        is_right.mean(),
        curve.accuracy_of_surest(0.98),
        np.concatenate(reviewed).mean(),
        left.mean() if len(left) else 1.0,
    )


def labels_of_drive(drive: Drive, overrides: tuple[str, ...]) -> Labels:
    """The labels of a stranger's recording."""
    rows = np.arange(len(drive.log))
    truth = LaneTruth(drive.log.frame_id, np.maximum(drive.lane, 1), drive.lane == 0)
    experiment = load_experiment(ZERO_LABEL, (*overrides, f"n_lanes={drive.n_lanes}"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return label_experiment(experiment, recorded=Recorded(drive.log, truth, rows, (), ()))


def draw(folder: Path) -> None:
    """The curves of the ten runs, and the end of the Spanish drive."""
    write_figure(curves_figure, folder / "labels.png")
    write_figure(lambda: review_figure(labels_of(6), 9540, 9776), folder / "labels_spain_9577.png")


def curves_figure() -> Figure:
    """Wrong labels among the frames that are not left to a human, against the share that is."""
    figure = new_figure(9.0, 3.6)
    simple = axes_at(figure, 0.8, 0.4, 3.7, 2.6)
    multi = axes_at(figure, 5.2, 0.4, 3.5, 2.6)
    for ax, runs in ((simple, [*SIMPLE["Italy"], *SIMPLE["Spain"]]), (multi, [5, 10])):
        for run in runs:
            _draw_curve(ax, run)
        ax.set_xlim(0, 10 if ax is simple else 40)
        ax.set_xlabel("frames left to a human, % (the least sure ones)", fontsize=9)
        ax.tick_params(labelsize=8)
        ax.grid(color="#ececec", linewidth=0.6)
        ax.set_axisbelow(True)
    simple.set_ylabel("wrong labels among the others, %", fontsize=9)
    simple.set_ylim(0, 0.15)
    multi.set_ylim(0, None)
    simple.plot(2, 0.1, "+", color=INK, markersize=10)
    simple.annotate("what was asked for", (2, 0.1), xytext=(6, 6), textcoords="offset points",
                    fontsize=8)  # fmt: skip
    simple.set_title("detectors of single lines", fontsize=9)
    multi.set_title("multi-lane detectors", fontsize=9)
    for ax in (simple, multi):
        ax.legend(fontsize=7.5, frameon=False, ncols=2)
    return figure


def _draw_curve(ax: Axes, run: int) -> None:
    labels = labels_of(run)
    truth, rows = labels.run.truth, labels.run.scored
    assert truth is not None
    keep = ~truth.is_crossing & ((truth.frame_id < LAST_TRUSTED) | (run < 6))
    right = labels.lane[rows] == truth.lane
    curve = answers_curve(labels.confidence[rows][keep], right[keep])
    colour = MODEL_COLOUR if run < 6 else DETECTOR_COLOUR
    style = ("-", "--", "-.", ":", "-")[(run - 1) % 5]
    none = "" if curve.accuracy.min() < 1 else ": none"
    road = ("Italy" if run < 6 else "Spain") + none
    ax.plot(
        100 * (1 - curve.coverage), 100 * (1 - curve.accuracy), linestyle=style, color=colour,
        linewidth=1.2, label=f"run {run}, {road}",
    )  # fmt: skip
