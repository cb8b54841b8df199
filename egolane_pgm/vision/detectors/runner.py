"""Run a detector over the pictures of a drive: find the plugin, check its answers."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from egolane_pgm.contracts import Detector, DetectorStep
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines


@dataclass(frozen=True)
class ReadyDetector:
    """A detector with its checked parameters. where: the beginning of messages."""

    name: str
    plugin: Detector
    parameters: Mapping[str, Value]
    where: str

    @property
    def is_stereo(self) -> bool:
        """Whether it needs the pictures of two cameras."""
        return self.plugin.stereo


def find_detector(
    name: str, given: Mapping[str, Any], where: str, given_by: str | None = None
) -> ReadyDetector:
    """Find a detector by its name, or in a file, and check its parameters.

    - given: values of parameters; the others keep their defaults
    - where: beginning of messages about the name
    - given_by: beginning of messages about parameters; by default `<where>: parameters`

    Raises InputError for an unknown detector or parameter and for a wrong value.
    """
    plugin = load_plugin(Detector, name, where)
    values = resolve_parameters(plugin.parameters, given, 1, given_by or f"{where}: parameters")
    for key, value in values.items():
        # A user's file (a program, a network).
        if isinstance(value, str) and value.endswith((".py", ".yaml", ".yml")):
            values[key] = os.path.realpath(value)
    return ReadyDetector(name, plugin, values, where)


def start(detector: ReadyDetector, camera: Camera) -> DetectorStep:
    """Prepare a detector for the first picture of a drive."""
    with plugin_errors(detector.plugin, detector.where):
        return detector.plugin.start(camera, detector.parameters)


def detect(
    detector: ReadyDetector, camera: Camera, pictures: Iterable[Picture]
) -> Iterator[tuple[int, FrameLines]]:
    """Run a detector over pictures; yield the frame id and the checked lines of each.

    Raises InputError, with detector and frame, for lines that break the detectors' contract.
    """
    step = start(detector, camera)
    for picture in pictures:
        where = f"{detector.where}: {detector.name}: frame {picture.frame_id}"
        try:
            with plugin_errors(detector.plugin, where):
                lines = step(picture)
        except InputError as error:
            text = str(error).removeprefix(f"{where}: ")
            raise InputError(f"{where}: {text}") from error
        if not isinstance(lines, FrameLines):
            raise InputError(f"{where}: gave {type(lines).__name__}, not FrameLines")
        yield picture.frame_id, lines
