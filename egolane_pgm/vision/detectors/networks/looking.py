"""What a network sees over a drive, frame by frame: as markings to find lines in, or as the part of
the road that other detectors look at."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import BoolArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.networks.answers import Answer
from egolane_pgm.vision.detectors.networks.description import (
    NO_NETWORK,
    Network,
    NetworkFile,
    read_network,
)
from egolane_pgm.vision.detectors.networks.layouts import answer, from_above
from egolane_pgm.vision.detectors.networks.running import fit_of, load
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye

PARAMETERS = (
    NetworkFile(
        "on_road",
        "choice",
        NO_NETWORK,
        "no network, or the YAML file of one: marking where it sees neither road nor lines is"
        " dropped (docs/networks.md)",
        choices=(NO_NETWORK,),
    ),
    Parameter(
        "on_road_margin_m",
        "non_negative",
        "auto",
        "how far beside what the network sees marking is kept, metres; auto: 0.3, as many networks"
        " leave the paint out of the road's area",
        choices=("auto",),
        highest=10,
    ),
)

#: The margin where none is given, metres.
_MARGIN_M = 0.3


def looker(network: Network, camera: Camera) -> Callable[[Picture], Answer | None]:
    """Makes a function that takes the pictures of a drive in order and gives what the network sees;
    None in frames that the network skips (`every`). Raises InputError as `load` does."""
    fit = fit_of(network, camera.width, camera.height)
    run = load(network, fit)
    count = 0

    def look(picture: Picture) -> Answer | None:
        nonlocal count
        is_spared, count = count % network.every > 0, count + 1
        return None if is_spared else answer(network, fit, run(picture.image))

    return look


def keep(camera: Camera, parameters: Parameters) -> Callable[[BirdsEye, Picture], BoolArray] | None:
    """Makes a function that takes the bird's-eye view of a frame and its picture, and gives where
    marking is kept, (R, C): on the road, or beside the lines, as the network of the parameter
    `on_road` sees them. In frames that the network skips, its last answer holds. None without a
    network."""
    if parameters["on_road"] == NO_NETWORK:
        return None
    network = read_network(str(parameters["on_road"]))
    look, given = looker(network, camera), parameters["on_road_margin_m"]
    margin = _MARGIN_M if given == "auto" else number(parameters, "on_road_margin_m")
    last = Answer(None)

    def kept(view: BirdsEye, picture: Picture) -> BoolArray:
        nonlocal last
        last = look(picture) or last
        return np.asarray(grown(view, from_above(view, last), margin) > 0)

    return kept


def grown(view: BirdsEye, mask: NDArray[np.uint8], margin_m: float) -> NDArray[np.uint8]:
    """The mask (R, C) with all that is within a margin, metres, to the side."""
    wide = 2 * round(margin_m / view.across_m) + 1
    return cv2.dilate(mask, np.ones((1, wide), dtype=np.uint8)).astype(np.uint8, copy=False)
