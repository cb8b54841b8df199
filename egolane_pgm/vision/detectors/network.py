"""A lane network of the user, run by OpenCV, with the tracking of the other detectors; see
docs/networks.md.

    egolane detect drive.mp4 --camera cam.yaml --detector network --set network=lanes.yaml
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter, Parameters, not_searched
from egolane_pgm.types import problems_in
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import Step
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.networks.finding import network_finder
from egolane_pgm.vision.detectors.simple import finder
from egolane_pgm.vision.detectors.simple.parameters import FINDING

STEREO = False
PARAMETERS = not_searched(
    (
        Parameter(
            "network",
            "text",
            "",
            "YAML file of the network (its ONNX, inputs and outputs), or the name of a ready one"
            " whose ONNX is in the current folder, such as lstr",
        ),
        next(p for p in FINDING if p.name == "curve"),
        *finder.MONO,
    )
)


def start(camera: Camera, parameters: Parameters) -> Step:
    """Start a drive. Raises InputError for a network that cannot be used."""
    path = str(parameters["network"])
    network = read_network(path)
    with problems_in(path):
        find = network_finder(camera, network, parameters)
    return finder.start(camera, parameters, curve=str(parameters["curve"]), finder=find)
