"""A lane network of the user, run by OpenCV, with the tracking of the other detectors; see
docs/networks.md.

    egolane detect drive.mp4 --camera cam.yaml --detector network --set network=lanes.yaml
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from egolane_pgm.parameters import Parameter, Parameters
from egolane_pgm.types import problems_in
from egolane_pgm.vision.camera.model import LANE_WIDTHS, Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, Step
from egolane_pgm.vision.detectors.networks.checking import describe_onnx
from egolane_pgm.vision.detectors.networks.description import read_network
from egolane_pgm.vision.detectors.networks.finding import network_finder
from egolane_pgm.vision.detectors.simple import finder
from egolane_pgm.vision.detectors.simple.parameters import FINDING

#: The number of first pictures after which the lines are checked.
_CHECKED = 20

#: A line nearer to the middle of the car is under it, metres.
_UNDER_M = 0.3

STEREO = False
PARAMETERS = (
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


def start(camera: Camera, parameters: Parameters) -> Step:
    """Start a drive; warn after some pictures if the lines are not plausible. Raises InputError for
    a network that cannot be used."""
    path = str(parameters["network"])
    network = read_network(path)
    with problems_in(path):
        find = network_finder(camera, network, parameters)
    follow = finder.start(camera, parameters, curve=str(parameters["curve"]), finder=find)
    seen: list[FrameLines] = []

    def step(picture: Picture) -> FrameLines:
        lines = follow(picture)
        if len(seen) < _CHECKED:
            seen.append(lines)
            if len(seen) == _CHECKED and (doubt := _doubt(seen)):
                fitting = describe_onnx(Path(network.model)).splitlines()
                fits = "; ".join(line for line in fitting if "fit" in line)
                warnings.warn(
                    f"{path}: doubtful: {doubt} in the first {_CHECKED} pictures; are layout"
                    f" {network.layout}, output, classes and size right? {fits}",
                    stacklevel=2,
                )
        return lines

    return step


def _doubt(seen: list[FrameLines]) -> str:
    """Return what is not plausible in the lines of some pictures, or nothing."""
    if not any(len(lines.lri) for lines in seen):
        return "no line was found"
    if all((np.abs(lines.offset_m) < _UNDER_M).any() for lines in seen):
        return "the car drives on a line (a mask of the road in place of its lines?)"
    gaps = np.concatenate([np.diff(lines.offset_m) for lines in seen])
    is_lane = (gaps > LANE_WIDTHS[0]) & (gaps < LANE_WIDTHS[1])
    return "" if is_lane.any() else "no two neighbouring lines were a lane apart"
