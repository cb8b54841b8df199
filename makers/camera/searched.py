"""Which parameters of the detectors matter on labelled pictures, and what a search gains.

The first 55 stills of `tusimple`, in five contiguous blocks of the drive that are held out in turn;
the ten clips, tracked, take no part and are scored with what is found. `egolane tune` with a
tuning file for pictures does all of it.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import yaml

import egolane_pgm as ego
from egolane_pgm.scoring.line_places import LINE_SCORES
from egolane_pgm.tuning.plan import load_plan
from egolane_pgm.views.study_tables import importance_line, score_rows
from egolane_pgm.views.tables import markdown
from egolane_pgm.vision.camera.model import write_camera
from egolane_pgm.vision.picture_task import counts_of, load_labelled
from makers.camera import tusimple
from makers.camera._following import data_path

TRIALS, DETECTORS = 60, ("ml", "mc")

#: What is searched of the finder, wide around the defaults.
RANGES: dict[str, list[float]] = {
    "marking_width_m": [0.15, 0.5],
    "smooth_along_m": [0.3, 2.0],
    "around_m": [2.0, 8.0],
    "least_contrast": [0.007, 0.06],
    "least_rise": [1.5, 12.0],
    "least_area_m2": [0.01, 0.12],
    "reach_m": [0.07, 0.25],
    "apart_m": [1.5, 2.8],
    "neighbour_bonus": [0.0, 1.0],
    "least_score": [0.04, 0.4],
}


def plan(folder: Path, detector: str, labels: Path, name: str, **pictures: Any) -> Path:
    """Write a tuning file."""
    content = {
        "name": name,
        "pictures": {
            "labels": str(labels),
            "camera": str(folder / "camera.yaml"),
            "detector": detector,
            **pictures,
        },
        "tuning": {"trials": TRIALS, "parameters": {f"detector.{k}": v for k, v in RANGES.items()}},
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def as_they_are(path: Path) -> list[float]:
    """F1, recall and precision with the detector's defaults."""
    seen = load_labelled(load_plan(path))
    point = {f"detector.{key}": seen.detector.parameters[key] for key in RANGES}
    counts = counts_of(seen, point).sum(axis=0)
    return [float(score(counts)) for score in LINE_SCORES.values()]


def measure() -> list[str]:
    """The figures as Markdown, or one line that says what is absent."""
    stills, clips = tusimple.data_file(), data_path("camera/tusimple_clips")
    if stills is None or clips is None:
        return ["Searched: camera/tusimple_frames or tusimple_clips is absent (EGOLANE_DATA)."]
    lines = [
        "### What a search of the detectors' parameters gains",
        "",
        f"The first {tusimple.HALF} stills, lines 10 m ahead within 0.35 m; {TRIALS} trials over"
        f" {len(RANGES)} parameters, each of five blocks of the drive with parameters found without"
        " it. The ten clips, tracked, took no part.",
    ]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write_camera(folder / "camera.yaml", tusimple.calibrated(stills))
        for detector in DETECTORS:
            lines += _searched(folder, detector, stills, clips)
    return lines


def _searched(folder: Path, detector: str, stills: Path, clips: Path) -> list[str]:
    on_stills = plan(folder, detector, stills, f"{detector}_stills", frames=[0, tusimple.HALF])
    on_clips = plan(folder, detector, clips / "labels.jsonl", f"{detector}_clips")
    tuned = ego.tune(str(on_stills), test_on=str(on_clips), jobs=os.cpu_count() or 1)
    header, rows = score_rows(tuned.studies[0].study)
    defaults = as_they_are(on_stills), as_they_are(on_clips)
    header = [header[0], "defaults", *header[1:], "clips: defaults"]
    rows = [
        [row[0], f"{mine:.3f}", *row[1:], f"{theirs:.3f}"]
        for row, mine, theirs in zip(rows, *defaults, strict=True)
    ]
    best = ", ".join(f"{k.removeprefix('detector.')} {v:.3g}" for k, v in tuned.best.items())
    matters = importance_line(tuned.trials()) or "too few trials to tell what matters"
    said = [f"{matters}.", "", f"Best: {best}."]
    return ["", f"**{detector}**", "", markdown(header, rows), "", *said]
