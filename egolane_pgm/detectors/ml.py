"""ML: one camera, straight lines (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from egolane_pgm.camera.model import Camera
from egolane_pgm.detectors import Step
from egolane_pgm.detectors.simple import finder as _simple
from egolane_pgm.parameters import Parameters

STEREO = False
PARAMETERS = _simple.PARAMETERS


def start(camera: Camera, parameters: Parameters) -> Step:
    """Pictures of one drive in, in order; straight lines out."""
    return _simple.start(camera, parameters, curve="line")
