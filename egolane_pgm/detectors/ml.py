"""ML: one camera, straight lines (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from egolane_pgm.camera.model import Camera
from egolane_pgm.detectors import Step
from egolane_pgm.detectors.simple import finder
from egolane_pgm.parameters import Parameters, held_fixed

STEREO = False
PARAMETERS = held_fixed(finder.PARAMETERS)


def start(camera: Camera, parameters: Parameters) -> Step:
    """Starts a drive: the step takes its pictures in order and gives straight lines."""
    return finder.start(camera, parameters, curve="line")
