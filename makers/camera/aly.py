"""Aly's detector on real pictures, by the measures of its paper and of `tusimple`.

The first 55 stills, on which settings were chosen, and the last frames of ten clips; the last 55
stills were not used. Aly 2008 compares a spline with a label in the picture: each is walked
along in steps of a pixel, and the distances to the nearest point of the other are averaged, once
there and once back, of which the smaller counts. A spline is right if mean <= 15 and median <= 20
pixels; the public Matlab program needs only one of both. Pixels are of a picture 640 wide,
as theirs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.classic.aly import Found, line_finder
from egolane_pgm.classic.bezier.ridges import FAR_M, NEAR_M
from egolane_pgm.types import FloatArray, IntArray
from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from egolane_pgm.vision.detectors.runner import find_detector, start
from makers.camera import clips, tusimple
from makers.camera._labels import (
    label_picture,
    label_places,
    line_points,
    read_labels,
)

WIDTH_PX = 640
MEAN_PX, MEDIAN_PX = 15.0, 20.0


def walked(points: FloatArray) -> FloatArray:
    """Points (P, 2) a pixel apart along the straight legs between points (N, 2)."""
    along = np.r_[0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    at = np.arange(0, along[-1] + 1e-9)
    return np.stack([np.interp(at, along, points[:, k]) for k in (0, 1)], axis=1)


def is_right(line: FloatArray, label: FloatArray, *, both: bool) -> bool:
    """Whether a line (A, 2) is a label (B, 2), pixels: mean and median distance must be small
    (both), as in the paper, or one of them, as in the Matlab program."""
    one, other = walked(line), walked(label)
    away = np.hypot(*(one[:, None] - other).transpose(2, 0, 1))
    nearest = away.min(axis=1), away.min(axis=0)
    means = min(float(side.mean()) for side in nearest) <= MEAN_PX
    medians = min(float(np.median(side)) for side in nearest) <= MEDIAN_PX
    return (means and medians) if both else (means or medians)


def paper_counts(lines: list[FloatArray], labels: list[FloatArray], *, both: bool) -> IntArray:
    """(3,): lines that are a label, each label taken once; lines; labels."""
    left, right = list(labels), 0
    for line in lines:
        for k, label in enumerate(left):
            if is_right(line, label, both=both):
                del left[k]
                right += 1
                break
    return np.array([right, len(lines), len(labels)])


def in_picture(camera: Camera, shape: FloatArray, from_m: float, to_m: float) -> FloatArray:
    """A line (4,) between two distances ahead as points (P, 2) of a picture 640 pixels wide."""
    x = np.linspace(from_m, to_m, 50)
    y = shape[0] + x * (shape[1] + x * (shape[2] / 2 + x * shape[3] / 6))
    return np.stack(road_to_image(camera, x, y), axis=1) * WIDTH_PX / camera.width


@dataclass(frozen=True)
class Measured:
    """Counts over some pictures. at_10_m (4,): as `tusimple.Still.counts`; paper, matlab (3,): as
    `paper_counts`."""

    at_10_m: FloatArray
    paper: IntArray
    matlab: IntArray

    def row(self, name: str) -> str:
        """A row of the table."""
        found, labels, right, lines = self.at_10_m
        cells = [f"{found / labels:.0%}", f"{right / max(lines, 1):.0%}"]
        for correct, detected, wanted in (self.paper, self.matlab):
            cells += [f"{correct / wanted:.0%}", f"{(detected - correct) / wanted:.0%}"]
        return f"| {name} | {' | '.join(cells)} |"


def measured(pictures: Iterable[tuple[Camera, dict[str, Any], Found]]) -> Measured:
    """What was found in labelled pictures: the camera, the label's row and the lines of each."""
    at_10_m, paper, matlab = [], [], []
    for camera, frame, found in pictures:
        still = tusimple.Still(
            label_places(camera, frame, tusimple.AHEAD_M),
            found.shape @ tusimple.AHEAD,
            np.ones(len(found.shape)),
        )
        at_10_m.append(still.counts())
        drawn = zip(found.shape, found.from_m, found.to_m, strict=True)
        lines = [in_picture(camera, *line) for line in drawn]
        labels = [points * WIDTH_PX / camera.width for points in line_points(frame)]
        paper.append(paper_counts(lines, labels, both=True))
        matlab.append(paper_counts(lines, labels, both=False))
    return Measured(np.sum(at_10_m, axis=0), np.sum(paper, axis=0), np.sum(matlab, axis=0))


def stills(labels: Path) -> Measured:
    """The first 55 stills, each for itself."""
    camera = tusimple.CAMERA
    find = line_finder(camera)
    return measured(
        (camera, frame, find(cv2.imread(str(label_picture(frame, labels)))))
        for frame in read_labels(labels)[: tusimple.HALF]
    )


def last_frames(folder: Path, *, tracked: bool) -> Measured:
    """The last frames of the ten clips, alone or as valid lines after the frames before."""
    camera = tusimple.CAMERA
    detector = find_detector("aly", {}, "clips")
    find = line_finder(camera)

    def found(images: list[Image]) -> Found:
        return find(images[-1])

    def followed(pictures: list[Any]) -> Found:
        step = start(detector, camera)
        lines = [step(picture) for picture in pictures][-1]
        shape = lines.shape[lines.is_valid]
        near, far = NEAR_M, FAR_M
        ends = np.full((2, len(shape)), [[near], [far]])
        return Found(shape, *ends)

    seen = []
    for frame in read_labels(folder / "labels.jsonl"):
        name = str(Path(frame["raw_file"]).parent).removeprefix("clips/")
        pictures = list(read_pictures(open_source(folder / name), camera))
        lines = followed(pictures) if tracked else found([p.image for p in pictures])
        seen.append((camera, frame, lines))
    return measured(seen)


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    labels, folder = tusimple.data_file(), clips.data()
    if labels is None or folder is None:
        return ["Aly: camera/tusimple_frames or tusimple_clips is absent (EGOLANE_DATA)."]
    return [
        "### Aly's detector",
        "",
        "Recall and precision at 10 m as above; correct and false as in Aly 2008, in shares of all"
        " labelled lines of the pictures, of which it finds at most four.",
        "",
        "| | recall | precision | correct, paper | false | correct, Matlab | false |",
        "|---|---|---|---|---|---|---|",
        stills(labels).row("first 55 stills (in-sample)"),
        last_frames(folder, tracked=False).row("ten clips, last frame alone"),
        last_frames(folder, tracked=True).row("ten clips, tracked"),
    ]
