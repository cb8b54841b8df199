"""SL: two cameras, straight lines (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from egolane_pgm.camera.model import Camera
from egolane_pgm.detectors import Step
from egolane_pgm.detectors.simple import finder as _simple
from egolane_pgm.detectors.simple import stereo as _stereo
from egolane_pgm.parameters import Parameters

STEREO = True
PARAMETERS = _simple.PARAMETERS + _stereo.PARAMETERS


def start(camera: Camera, parameters: Parameters) -> Step:
    """Pairs of pictures of one drive in, in order; straight lines out."""
    return _simple.start(
        camera, parameters, curve="line", on_road=_stereo.on_road(camera, parameters)
    )
