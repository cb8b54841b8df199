"""Lines in single stills of a worn, crowded motorway, against hand labels.

110 stills in the order of one drive. Camera and every setting were chosen on the first 55; the
other 55 are the test. Lines and labels are compared where they are 10 m ahead of the camera, a
label's points brought onto the road by the camera and joined by straight lines (if they do not
reach that far, by the straight line through the six nearest). Pairs within 0.35 m are matched one
to one, nearest first. Recall counts the labels within 6 m to either side, matched with any line;
precision the lines within 6 m, matched with any label.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import powers
from egolane_pgm.vision.detectors.simple.fit import find_lines, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from makers.camera._following import data_path
from makers.camera._labels import (
    label_picture,
    label_places,
    read_labels,
)

FILE = "camera/tusimple_frames/labels.jsonl"
HALF = 55

#: A lens of 62 degrees, and the pose that the labelled lines of the first half show, 3.66 m apart.
CAMERA = Camera(
    1280,
    720,
    1065.1388687043316,
    1065.1388687043316,
    639.5,
    359.5,
    height_m=1.6520693052337605,
    pitch_deg=-6.618281461728446,
    yaw_deg=-0.8592455836525548,
    lane_width_m=3.66,
)

AHEAD_M = 10.0
AHEAD = powers(AHEAD_M)
TOLERANCE_M = 0.35
SIDE_M = 6.0


def matched(label_m: FloatArray, line_m: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Match lines with labels one to one, nearest first: which labels (A,) and lines (B,) are."""
    label, line = np.zeros(len(label_m), dtype=bool), np.zeros(len(line_m), dtype=bool)
    away = np.abs(label_m[:, None] - line_m)
    for flat in np.argsort(away, axis=None, kind="stable"):
        a, b = np.unravel_index(flat, away.shape)
        if away[a, b] > TOLERANCE_M:
            break
        if not (label[a] or line[b]):
            label[a] = line[b] = True
    return label, line


@dataclass(frozen=True)
class Still:
    """One still. label_m (A,), line_m (B,): labels and lines 10 m ahead, metres to the right.
    score (B,): of the lines."""

    label_m: FloatArray
    line_m: FloatArray
    score: FloatArray

    def matched(self, least_score: float = 0.0) -> tuple[BoolArray, BoolArray]:
        """Which labels (A,) and which lines (B,) are matched, lines below a score left out."""
        kept = self.score >= least_score
        label, line = np.zeros(len(self.label_m), bool), np.zeros(len(self.line_m), bool)
        label[:], line[kept] = matched(self.label_m, self.line_m[kept])
        return label, line

    def counts(self, least_score: float = 0.0) -> FloatArray:
        """(4,): labels found, labels, lines that are labelled, lines."""
        label, line = self.matched(least_score)
        near_label = np.abs(self.label_m) <= SIDE_M
        near_line = (np.abs(self.line_m) <= SIDE_M) & (self.score >= least_score)
        pairs = (label, near_label), (line, near_line)
        counted = [n for hit, near in pairs for n in ((hit & near).sum(), near.sum())]
        return np.array(counted, dtype=np.float64)


def data_file() -> Path | None:
    """The labels, or None if they are absent."""
    return data_path(FILE)


def look_at(labels: Path, which: slice, **parameters: Any) -> list[Still]:
    """Lines and labels of some of the stills, single frames, lines of any score."""
    camera = CAMERA
    settings = resolve_parameters(FINDING, {"least_score": 0.0, **parameters}, 1)
    view = view_for(camera, settings)
    stills = []
    for frame in read_labels(labels)[which]:
        found = find_lines(view, cv2.imread(str(label_picture(frame, labels))), settings)
        stills.append(Still(label_places(camera, frame, AHEAD_M), found.shape @ AHEAD, found.score))
    return stills


def recall_precision(stills: list[Still], least_score: float) -> tuple[float, float]:
    """Shares of labels found and of lines that are labelled."""
    counts = np.sum([still.counts(least_score) for still in stills], axis=0)
    recall, precision = _shares(counts)
    return float(recall), float(precision)


def _shares(counts: FloatArray) -> FloatArray:
    """Recall and precision (2, ...) of summed counts (..., 4); NaN without labels, or lines."""
    of = np.where(counts == 0, np.nan, counts)
    return np.stack([counts[..., 0] / of[..., 1], counts[..., 2] / of[..., 3]])


def interval(stills: list[Still], least_score: float) -> FloatArray:
    """(2, 2): 95 % intervals of recall and precision; stills resampled 2,000 times, seed 0."""
    counts = np.array([still.counts(least_score) for still in stills])
    rng = np.random.default_rng(0)
    draws = rng.integers(len(counts), size=(2000, len(counts)))
    sums = counts[draws].sum(axis=1)
    return np.percentile(_shares(sums), [2.5, 97.5], axis=1).T


def curve(stills: list[Still]) -> FloatArray:
    """(K, 3): score threshold, recall, precision."""
    thresholds = np.unique(np.concatenate([still.score for still in stills]))[::4]
    return np.array([[t, *recall_precision(stills, t)] for t in thresholds])


def errors_m(stills: list[Still], least_score: float) -> FloatArray:
    """How far matched labels are from the nearest line, metres."""
    away = []
    for still in stills:
        label, line = still.matched(least_score)
        for place in still.label_m[label & (np.abs(still.label_m) <= SIDE_M)]:
            away.append(np.abs(still.line_m[line] - place).min())
    return np.array(away)


@cache
def _halves(labels: Path, curve: str = "clothoid") -> tuple[list[Still], list[Still]]:
    first, last = slice(0, HALF), slice(HALF, None)
    return look_at(labels, first, curve=curve), look_at(labels, last, curve=curve)


def least_score() -> float:
    """The default threshold of the detectors."""
    return float(resolve_parameters(FINDING, {}, 1)["least_score"])


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    labels = data_file()
    if labels is None:
        return [f"Single stills: {FILE} is absent (EGOLANE_DATA)."]
    camera = CAMERA
    lines = [
        "### Single stills, no tracking",
        "",
        f"Lines within {SIDE_M:g} m to either side, matched one to one with hand labels within"
        f" {TOLERANCE_M} m at {AHEAD_M:g} m ahead. Camera ({camera.height_m:.2f} m high, from the"
        " labelled lines) and all settings from the first 55 stills of the drive.",
        "",
        "| fitted | stills | labelled lines | recall | 95 % | precision | 95 % | median error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    at = least_score()
    names = ("first 55 (in-sample)", "**last 55 (held out)**")
    for curve in ("clothoid", "line"):
        for name, stills in zip(names, _halves(labels, curve), strict=True):
            recall, precision = recall_precision(stills, at)
            (r_low, r_high), (p_low, p_high) = interval(stills, at)
            n_labels = int(np.sum([still.counts() for still in stills], axis=0)[1])
            lines.append(
                f"| {curve}s | {name} | {n_labels} | {recall:.1%} | {r_low:.0%} to {r_high:.0%} |"
                f" {precision:.1%} | {p_low:.0%} to {p_high:.0%} |"
                f" {np.median(errors_m(stills, at)):.2f} m |"
            )
    lines += [
        "",
        "A label that does not reach 10 m ahead is continued straight. Recall: labels within 6 m,"
        " matched with any line; precision: lines within 6 m, matched with any label.",
    ]
    return lines


def draw(folder: Path) -> None:
    """The precision-recall curve over the score's threshold, of clothoids: tusimple_pr.png."""
    labels = data_file()
    if labels is None:
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    styles = (("first 55 stills (settings chosen here)", "#0072B2", "--"),)
    styles += (("last 55 stills (held out)", "#D55E00", "-"),)
    for (name, colour, style), stills in zip(styles, _halves(labels), strict=True):
        _, recall, precision = curve(stills).T
        axes.plot(recall, precision, style, color=colour, label=name)
        axes.plot(*recall_precision(stills, least_score()), "o", color=colour)
    axes.plot([0.7, 0.7, 1], [1, 0.75, 0.75], ":", color="#555555", label="wanted: right and above")
    axes.set(xlim=(0, 1), ylim=(0.4, 1.01), xlabel="recall", ylabel="precision")
    axes.set_title("Clothoids in single stills, by score threshold (dot: default)", fontsize=10)
    axes.legend(loc="lower left", fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(folder / "tusimple_pr.png", dpi=150)
