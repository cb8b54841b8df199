"""The detectors on a simulated drive at 1280x720: frames per second, and where the time goes.

`python -m tests.benchmarks.bench_camera` prints these rows alone. CPU time on one thread, pictures
already decoded. A detector's own row is the median over the last frames of a drive, with
tracking. Below it stand its functions, with all that they call, that take a twentieth of its time
or more: means per frame as Python's profiler tells them, which makes short functions look slower.
Where the first 55 of the labelled stills are at hand (EGOLANE_DATA), detectors for one camera run
over them as well.
"""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import cv2

from egolane_pgm.plugins import plugin_names
from egolane_pgm.simulation import simulated_road
from egolane_pgm.types import InputError
from egolane_pgm.vision import detectors
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.runner import Detector, find_detector, start
from egolane_pgm.vision.simulated import draw_frame
from makers.camera import tusimple
from makers.camera._labels import label_picture, read_labels

HEADER = ("camera picture, 1280x720", "per frame", "frames per second")
FRAMES = 60

#: The first frames do not count: kernels are compiled, and the camera is looked at more closely.
_WARM_UP = 20
CAMERA = Camera(1280, 720, 1000.0, 1000.0, 639.5, 300.0, 1.5, pitch_deg=-1.0, baseline_m=0.4)
PAIR = CAMERA, replace(CAMERA, lateral_m=0.4)

#: The least share of a detector's time at which a function is listed.
_LEAST_SHARE = 0.05

Line = tuple[str, float]


def camera_lines(frames: int = FRAMES) -> list[Line]:
    """(what, seconds per frame) of every detector of the package that starts without further
    parameters, and of its functions."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        road = simulated_road("a4", 0, frames)
        pictures = [Picture(k, *(draw_frame(road, k, c) for c in PAIR)) for k in range(frames)]
        lines = []
        for name in plugin_names("detectors"):
            try:
                detector = find_detector(name, {}, Path.cwd(), "detector")
                start(detector, CAMERA)
            except InputError:
                continue
            lines.append((f"**{name}**", _seconds(detector, CAMERA, pictures)))
            if not detector.is_stereo and tusimple.data_file():
                lines.append((f"**{name}**, real stills", _seconds(detector, *_stills())))
            lines += _functions(detector, CAMERA, pictures)
        return lines
    finally:
        cv2.setNumThreads(threads)


def _stills() -> tuple[Camera, list[Picture]]:
    labels = tusimple.data_file()
    assert labels is not None
    files = [label_picture(frame, labels) for frame in read_labels(labels)[: tusimple.HALF]]
    pictures = [Picture(k, cv2.imread(str(file))) for k, file in enumerate(files)]
    return tusimple.CAMERA, pictures


def _seconds(detector: Detector, camera: Camera, pictures: Sequence[Picture]) -> float:
    """The median CPU time of a frame."""
    step, times = start(detector, camera), []
    for picture in pictures:
        begun = time.process_time()
        step(picture)
        times.append(time.process_time() - begun)
    return median(times[_WARM_UP:])


def _functions(detector: Detector, camera: Camera, pictures: Sequence[Picture]) -> list[Line]:
    """The functions of the package that take most of a detector's time, longest first."""
    step = start(detector, camera)
    for picture in pictures[:_WARM_UP]:
        step(picture)
    profile = cProfile.Profile(time.process_time)
    for picture in pictures[_WARM_UP:]:
        profile.runcall(step, picture)
    folder = Path(detectors.__file__).parent
    taken = {
        f"{Path(file).stem}.{function}": seconds / (len(pictures) - _WARM_UP)
        for (file, _, function), (_, _, _, seconds, _) in pstats.Stats(profile).stats.items()  # type: ignore[attr-defined]
        if Path(file).is_relative_to(folder)
    }
    whole = max(taken.values())
    longest = sorted(taken.items(), key=lambda one: -one[1])
    return [
        (f"{detector.name}: {function}", seconds)
        for function, seconds in longest
        if _LEAST_SHARE * whole <= seconds < 0.95 * whole
    ]


def markdown(lines: list[Line]) -> str:
    """The lines as a Markdown table."""
    rows = [f"| {' | '.join(HEADER)} |", "|---|---:|---:|"]
    rows += [
        f"| {what} | {1e3 * seconds:.2f} ms | {'' if ':' in what else f'{1 / seconds:.0f}'} |"
        for what, seconds in lines
    ]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(markdown(camera_lines()))
