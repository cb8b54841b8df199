"""Your own lane network, run by OpenCV: its markings are fitted and followed as those of the other
detectors. docs/networks.md shows how to describe it.

    egolane detect drive.mp4 --camera cam.yaml --detector network --set network=lanes.yaml
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameters, held_fixed
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.detectors import Step
from egolane_pgm.vision.detectors.networks.description import NetworkFile, read_network
from egolane_pgm.vision.detectors.networks.finding import network_finder
from egolane_pgm.vision.detectors.simple import finder
from egolane_pgm.vision.detectors.simple.parameters import FINDING

STEREO = False
PARAMETERS = held_fixed(
    (
        NetworkFile(
            "network",
            "choice",
            "",
            "the YAML file that describes the network (its ONNX, what goes in and what comes out),"
            " or the name of one that comes along, whose ONNX lies here, such as lstr",
        ),
        next(p for p in FINDING if p.name == "curve"),
        *finder.PARAMETERS,
    )
)


def start(camera: Camera, parameters: Parameters) -> Step:
    """Starts a drive: the step takes its pictures in order and gives the network's lines.

    Raises InputError for a network that cannot be used, or that finds no lines.
    """
    network = read_network(str(parameters["network"]))
    if network.layout == "drivable":
        raise InputError(
            f"{network.files[0]}: layout drivable has no lines; name it as on_road, a parameter of"
            " another detector such as ml, or take an output with lines"
        )
    return finder.start(
        camera,
        parameters,
        curve=str(parameters["curve"]),
        finder=network_finder(camera, network, parameters),
    )
