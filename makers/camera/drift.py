"""Lines of a camera that is pitched by a degree more or less than it was calibrated, corrected.

The first 55 stills of `tusimple`, in order, as a slow drive. The constants of the watch were chosen
on them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.camera.pictures import read_image
from egolane_pgm.vision.detectors.runner import detect, find_detector
from egolane_pgm.vision.detectors.simple import drift
from egolane_pgm.vision.detectors.simple.birdseye import turned_up
from egolane_pgm.vision.detectors.simple.fit import find_lines, view_for
from makers.camera import tusimple
from makers.camera._labels import label_picture, label_places, read_labels

#: Detectors, and what they fit.
CURVES = {"ml": "line", "mc": "clothoid"}


@dataclass(frozen=True)
class Turned:
    """The stills with a camera that is turned up against its calibration. stills: lines and labels
    of each. pitch_deg, sd_deg (F,): the estimate minus the calibration that was turned, and its
    standard deviation. warned: the warnings."""

    stills: list[tusimple.Still]
    pitch_deg: FloatArray
    sd_deg: FloatArray
    warned: list[str]


def stills_of(labels: Path) -> list[Picture]:
    """The first 55 stills."""
    frames = read_labels(labels)[: tusimple.HALF]
    return [Picture(k, read_image(label_picture(f, labels))) for k, f in enumerate(frames)]


def look_at(labels: Path, shown: Iterable[Picture], name: str, away_deg: float) -> Turned:
    """Single-frame lines in the corrected view."""
    camera = tusimple.CAMERA
    values = {**find_detector(name, {}, "drift").parameters, "curve": CURVES[name]}
    values["camera_drift"] = "correct"
    view = view_for(replace(camera, pitch_deg=camera.pitch_deg + away_deg), values)
    look, turned = drift.watch(view, values), turned_up(view)
    stills, pitch, sd = [], [], []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for picture, frame in zip(shown, read_labels(labels), strict=False):
            believed = look(picture)
            pitch.append(believed.pitch_deg + away_deg)
            sd.append(believed.pitch_sd_deg)
            found = find_lines(turned(believed.correction_deg), picture.image, values)
            places = label_places(camera, frame, tusimple.AHEAD_M)
            stills.append(tusimple.Still(places, found.shape @ tusimple.AHEAD, found.score))
    return Turned(stills, np.array(pitch), np.array(sd), [str(one.message) for one in caught])


def warned_of(shown: Iterable[Picture], camera: Camera, name: str) -> list[str]:
    """The detector's warnings about a camera over some pictures."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in detect(find_detector(name, {}, "drift"), camera, shown):
            pass
    return [str(one.message) for one in caught]


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    labels = tusimple.data_file()
    if labels is None:
        return [f"A camera that was turned: {tusimple.FILE} is absent (EGOLANE_DATA)."]
    shown = stills_of(labels)
    lines = [
        "### A camera that was turned",
        "",
        "The first 55 stills (in-sample), the camera turned up against its calibration and"
        " corrected by what it sees (`camera_drift: correct`); single frames, as above.",
        "",
        "| detector | turned by, degrees | recall | precision | off after 5, 10, 20 and 55 stills |"
        " warned in |",
        "|---|---|---|---|---|---|",
    ]
    for name in CURVES:
        for away in (-1.0, 0.0, 1.0):
            turned = look_at(labels, shown, name, away)
            recall, precision = tusimple.recall_precision(turned.stills, 0.0)
            off = ", ".join(
                f"{turned.pitch_deg[k]:+.2f} ({turned.sd_deg[k]:.2f})" for k in (4, 9, 19, 54)
            )
            notes = " ".join(line.split(":")[0] for line in turned.warned) or "none"
            row = (name, f"{away:+.1f}", f"{recall:.1%}", f"{precision:.1%}", off, notes)
            lines.append(f"| {' | '.join(row)} |")
    return lines
