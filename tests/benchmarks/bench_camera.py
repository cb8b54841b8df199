"""The detectors on a rendered drive at 1312x540: frames per second, and where the time goes.

`python -m tests.benchmarks.bench_camera` prints these rows alone. CPU time on one thread, pictures
already decoded, medians over the frames of a drive in traffic.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from statistics import median
from typing import Any

import cv2

from egolane_pgm import detectors
from egolane_pgm.camera.picture import Picture
from egolane_pgm.detectors.simple import fit as _fit
from egolane_pgm.detectors.simple import matchers as _matchers
from egolane_pgm.detectors.simple import stereo as _stereo
from egolane_pgm.detectors.simple.contours import find_strips
from egolane_pgm.detectors.simple.markings import marking_mask
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.simulation.rendering.render import Scene, make_scene, render_frame

HEADER = ("camera picture, 1312x540", "per frame", "frames per second")
NAMES = ("ml", "mc", "sl", "sc")
FRAMES = 40

Line = tuple[str, float]


def camera_lines(frames: int = FRAMES) -> list[Line]:
    """(what, seconds per frame) of the stages of ml, of what sl does more, then of whole
    detectors."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        scene = make_scene("a4", seed=0, frames=frames + 1, stereo=True)
        rendered = [render_frame(scene, k) for k in range(frames + 1)]
        pictures = [Picture(k, f.image, f.right) for k, f in enumerate(rendered)]
        stages = _stages(scene, pictures) + _stereo_stages(scene, pictures)
        return stages + _whole(scene, pictures)
    finally:
        cv2.setNumThreads(threads)


def _stopwatch() -> tuple[Callable[[str, Callable[[], Any]], Any], dict[str, list[float]]]:
    """What makes a call under a name, and the seconds that each name took."""
    taken: dict[str, list[float]] = {}

    def timed(what: str, call: Callable[[], Any]) -> Any:
        begun = time.process_time()
        made = call()
        taken.setdefault(what, []).append(time.process_time() - begun)
        return made

    return timed, taken


def _stages(scene: Scene, pictures: list[Picture]) -> list[Line]:
    parameters: Parameters = {**_defaults("ml"), "curve": "line"}
    view = _fit.view_for(scene.camera, parameters)
    timed, taken = _stopwatch()
    for picture in pictures:
        above = timed("from above", lambda p=picture: _fit.from_above(view, p.image))
        mask = timed("marking mask", lambda a=above: marking_mask(view, a, parameters))
        strips = timed("contours", lambda m=mask: find_strips(view, m, parameters))
        timed("fit", lambda s=strips: _fit.fit_lines(view, s, parameters))
    # The first frame compiled.
    return [(f"ml: {what}", median(times[1:])) for what, times in taken.items()]


def _stereo_stages(scene: Scene, pictures: list[Picture]) -> list[Line]:
    parameters = _defaults("sl")
    pair = _stereo.make_pair(scene.camera, parameters)
    match = _matchers.find_matcher(parameters, "matcher")
    timed, taken = _stopwatch()
    for picture in pictures:
        small = timed("made smaller", lambda p=picture: _stereo.reduced(pair, p))
        found = timed("disparity", lambda s=small: _stereo.disparities(pair, match, *s))
        plane = timed("plane", lambda d=found: _stereo.find_plane(pair, d, parameters))
        timed("off the plane", lambda d=found, p=plane: _stereo.off_plane(pair, d, p, parameters))
    return [(f"sl: {what}", median(times[1:])) for what, times in taken.items()]


def _whole(scene: Scene, pictures: list[Picture]) -> list[Line]:
    lines = []
    folder = Path(detectors.__file__).parent
    for name in (n for n in NAMES if (folder / f"{n}.py").is_file()):
        module = import_module(f"{detectors.__name__}.{name}")
        step = module.start(scene.camera, _defaults(name))
        times = []
        for picture in pictures:
            begun = time.process_time()
            step(picture)
            times.append(time.process_time() - begun)
        lines.append((f"**{name}**, with tracking", median(times[1:])))
    return lines


def _defaults(name: str) -> Parameters:
    module = import_module(f"{detectors.__name__}.{name}")
    return resolve_parameters(module.PARAMETERS, {}, 1)


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
