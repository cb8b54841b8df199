"""SC: two cameras, clothoids (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from egolane_pgm.parameters import Parameters, held_fixed
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import Step
from egolane_pgm.vision.detectors.simple import finder, stereo

STEREO = True
PARAMETERS = held_fixed(finder.PARAMETERS + stereo.PARAMETERS)


def start(camera: Camera, parameters: Parameters) -> Step:
    """Starts a drive: the step takes its pairs of pictures in order and gives clothoids."""
    return finder.start(
        camera, parameters, curve="clothoid", on_road=stereo.on_road(camera, parameters)
    )
