"""Run a detector over the pictures of a drive: find the plugin, check its answers and collect its
lines."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.types import FloatArray, InputError, LineLog
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, Step, as_log


@dataclass(frozen=True)
class Detector:
    """A detector's module and its checked parameters. where: the beginning of messages."""

    name: str
    module: ModuleType
    parameters: Mapping[str, Value]
    where: str

    @property
    def is_stereo(self) -> bool:
        """Whether it needs the pictures of two cameras."""
        return bool(self.module.STEREO)


def find_detector(
    name: str, given: Mapping[str, Any], base: Path, where: str, given_by: str | None = None
) -> Detector:
    """Find a detector by its name, or in a file relative to `base`, and check its parameters.

    - given: values of parameters; the others keep their defaults
    - where: beginning of messages about the name
    - given_by: beginning of messages about parameters; by default `<where>: parameters`

    Raises InputError for an unknown detector or parameter and for a wrong value.
    """
    own = str(base / name) if name.endswith(".py") else name
    module = load_plugin("detectors", own, where)
    specs = getattr(module, "PARAMETERS", ())
    values = resolve_parameters(specs, given, 1, given_by or f"{where}: parameters")
    for key, value in values.items():
        # A user's file (a program, a network), relative to `base` as well.
        if isinstance(value, str) and value.endswith((".py", ".yaml", ".yml")):
            values[key] = os.path.realpath(base / value)
    return Detector(name, module, values, where)


def check_pair(detector: Detector, camera: Camera, has_right: bool, where: str) -> None:
    """Raise InputError if a stereo detector has no second camera, or a mono detector has one."""
    if detector.is_stereo and not has_right:
        raise InputError(f"{where}: detector {detector.name} needs the pictures of a second camera")
    if has_right and not detector.is_stereo:
        raise InputError(f"{where}: detector {detector.name} has one camera; leave the second out")
    if detector.is_stereo and camera.baseline_m is None:
        raise InputError(
            f"{detector.where}: {detector.name} needs the distance of the two cameras, baseline_m"
            " of the camera"
        )


def start(detector: Detector, camera: Camera) -> Step:
    """Prepare a detector for the first picture of a drive."""
    with plugin_errors(detector.module, detector.where):
        step: Step = detector.module.start(camera, detector.parameters)
    return step


def detect(
    detector: Detector, camera: Camera, pictures: Iterable[Picture]
) -> Iterator[tuple[int, FrameLines]]:
    """Run a detector over pictures; yield the frame id and the checked lines of each.

    Raises InputError, with detector and frame, for lines that break the detectors' contract.
    """
    step = start(detector, camera)
    for picture in pictures:
        where = f"{detector.where}: {detector.name}: frame {picture.frame_id}"
        try:
            with plugin_errors(detector.module, where):
                lines = step(picture)
        except InputError as error:
            text = str(error).removeprefix(f"{where}: ")
            raise InputError(f"{where}: {text}") from error
        if not isinstance(lines, FrameLines):
            raise InputError(f"{where}: gave {type(lines).__name__}, not FrameLines")
        yield picture.frame_id, lines


@dataclass(frozen=True)
class Collected:
    """The lines of a drive, None without a frame, and the reason for an early end, or None."""

    log: LineLog | None
    stopped: KeyboardInterrupt | InputError | None


def collect(
    frames: Iterable[tuple[int, FrameLines]],
    frame_rate: float,
    source: str,
    time_s: FloatArray | None = None,
) -> Collected:
    """Collect the lines of a drive into one log. Ctrl-C or a bad picture keeps the frames before.

    - frames: pairs of frame id and lines, as `detect` yields them
    - frame_rate: Hz
    - source: origin of the lines, for messages
    - time_s: time of the frame of each id, seconds; None for frame id over frame rate
    """
    found: list[tuple[int, FrameLines]] = []
    stopped: KeyboardInterrupt | InputError | None = None
    try:
        found.extend(frames)
    except (KeyboardInterrupt, InputError) as reason:
        stopped = reason
    if not found:
        return Collected(None, stopped)
    log = as_log(found, frame_rate, source)
    return Collected(log if time_s is None else replace(log, time_s=time_s[log.frame_id]), stopped)
