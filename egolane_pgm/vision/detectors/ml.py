"""ML: one camera, straight lines (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from egolane_pgm.parameters import Parameters, held_fixed
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import Step
from egolane_pgm.vision.detectors.simple import finder

STEREO = False
PARAMETERS = held_fixed(finder.PARAMETERS)


def start(camera: Camera, parameters: Parameters) -> Step:
    """Starts a drive: the step takes its pictures in order and gives straight lines."""
    return finder.start(camera, parameters, curve="line")
