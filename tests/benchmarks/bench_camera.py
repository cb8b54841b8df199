"""The detectors on a simulated drive at 1280x720: frames per second.

`python -m tests.benchmarks.bench_camera` prints these rows alone. CPU time on one thread, pictures
already decoded: the median over the last frames of a drive, with tracking. Where the first 55 of
the labelled stills are at hand (EGOLANE_DATA), detectors for one camera run over them as well.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from statistics import median

import cv2

from egolane_pgm.contracts import Detector
from egolane_pgm.plugins import plugin_names
from egolane_pgm.simulation import simulated_road
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.runner import ReadyDetector, find_detector, start
from egolane_pgm.vision.simulated import draw_frame
from makers.camera import tusimple
from makers.camera._labels import label_picture, read_labels

HEADER = ("camera picture, 1280x720", "per frame", "frames per second")
FRAMES = 60

#: The first frames do not count: kernels are compiled, and the camera is looked at more closely.
_WARM_UP = 20
CAMERA = Camera(1280, 720, 1000.0, 1000.0, 639.5, 300.0, 1.5, pitch_deg=-1.0, baseline_m=0.4)
PAIR = CAMERA, replace(CAMERA, lateral_m=0.4)

Line = tuple[str, float]


def camera_lines(frames: int = FRAMES) -> list[Line]:
    """(what, seconds per frame) of every detector of the package that starts without further
    parameters."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        road = simulated_road("a4", 0, frames)
        pictures = [Picture(k, *(draw_frame(road, k, c) for c in PAIR)) for k in range(frames)]
        lines = []
        for name in plugin_names(Detector):
            try:
                detector = find_detector(name, {}, "detector")
                start(detector, CAMERA)
            except InputError:
                continue
            lines.append((f"**{name}**", _seconds(detector, CAMERA, pictures)))
            if not detector.is_stereo and tusimple.data_file():
                lines.append((f"**{name}**, real stills", _seconds(detector, *_stills())))
        return lines
    finally:
        cv2.setNumThreads(threads)


def _stills() -> tuple[Camera, list[Picture]]:
    labels = tusimple.data_file()
    assert labels is not None
    files = [label_picture(frame, labels) for frame in read_labels(labels)[: tusimple.HALF]]
    pictures = [Picture(k, cv2.imread(str(file))) for k, file in enumerate(files)]
    return tusimple.CAMERA, pictures


def _seconds(detector: ReadyDetector, camera: Camera, pictures: Sequence[Picture]) -> float:
    """The median CPU time of a frame."""
    step, times = start(detector, camera), []
    for picture in pictures:
        begun = time.process_time()
        step(picture)
        times.append(time.process_time() - begun)
    return median(times[_WARM_UP:])


def markdown(lines: list[Line]) -> str:
    """The lines as a Markdown table."""
    rows = [f"| {' | '.join(HEADER)} |", "|---|---:|---:|"]
    rows += [f"| {what} | {1e3 * seconds:.2f} ms | {1 / seconds:.0f} |" for what, seconds in lines]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(markdown(camera_lines()))
