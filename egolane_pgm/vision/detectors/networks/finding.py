"""What a network sees over a drive: lines, or the part of the road that other detectors look at."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import powers
from egolane_pgm.vision.detectors.networks.description import (
    NO_NETWORK,
    Network,
    NetworkFile,
    read_network,
)
from egolane_pgm.vision.detectors.networks.layouts import Answer, Line, answer
from egolane_pgm.vision.detectors.networks.running import fit_of, load
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look
from egolane_pgm.vision.detectors.simple.fit import APART_M, Found, find_lines
from egolane_pgm.vision.detectors.simple.parameters import CURVES

PARAMETERS = (
    NetworkFile(
        "on_road",
        "choice",
        NO_NETWORK,
        "no network, or the YAML file of one with a mask: marking where it sees neither road nor"
        " lines is dropped (docs/networks.md)",
        choices=(NO_NETWORK,),
    ),
)

#: How far beside what the network sees marking is kept, metres, as many networks leave the paint
#: out of the road's area.
_MARGIN_M = 0.3

#: Points of lines that are farther ahead, or to the side, are left out, metres.
_FARTHEST_M, _ASIDE_M = 150.0, 100.0

#: The shortest line that is fitted, metres ahead, the distance of its places, and where lines are
#: compared.
_LEAST_M, _STEP_M, _COMPARED_M = 3.0, 1.0, 10.0

#: Weights of 0 for offset, heading (m/m), curvature (1/m) and its rate (1/m^2): one over the square
#: of what is usual.
_USUAL = np.array([0.0, 0.05**-2, 0.001**-2, 4e-5**-2])

#: Standard deviation of a place, metres, and how much more for each metre ahead.
_NEAR_SD_M, _SD_PER_M = 0.05, 0.01

#: Takes a bird's-eye view, a picture, the lines expected in it (P, 4) or None, and which pixels of
#: the view count, (R, C) or None.
Finder = Callable[[BirdsEye, Picture, FloatArray | None, BoolArray | None], Found]


def looker(network: Network, camera: Camera) -> Callable[[Picture], Answer]:
    """Make a function from a picture to what the network sees. Raises InputError as `load` does."""
    fit = fit_of(network, camera.width, camera.height)
    run = load(network, fit)
    return lambda picture: answer(network, fit, run(picture.image))


def from_above(view: BirdsEye, seen: Answer) -> BoolArray:
    """Where the bird's-eye view shows what a mask marks, (R, C)."""
    assert seen.mask is not None
    return np.asarray((look(view, seen.mask) > 127) & view.valid)


def keep_on_road(
    camera: Camera, parameters: Parameters
) -> Callable[[BirdsEye, Picture], BoolArray] | None:
    """Make a function that takes the bird's-eye view of a frame and its picture, and gives where
    marking is kept, (R, C): where the network of the parameter `on_road` sees the road or lines, or
    beside. None without a network."""
    if parameters["on_road"] == NO_NETWORK:
        return None
    network = read_network(str(parameters["on_road"]))
    if network.layout not in ("drivable", "lanes"):
        raise InputError(f"{network.files[0]}: on_road needs a mask: layout drivable or lanes")
    see = looker(network, camera)

    def kept(view: BirdsEye, picture: Picture) -> BoolArray:
        # The margin is to the side only.
        around = np.ones((1, 2 * round(_MARGIN_M / view.across_m) + 1), dtype=np.uint8)
        return np.asarray(cv2.dilate(from_above(view, see(picture)).astype(np.uint8), around) > 0)

    return kept


def network_finder(camera: Camera, network: Network, parameters: Parameters) -> Finder:
    """Make the function that finds the lines of a network. Raises InputError as `load` does."""
    see = looker(network, camera)

    def find(
        view: BirdsEye, picture: Picture, prior: FloatArray | None, counts: BoolArray | None
    ) -> Found:
        seen = see(picture)
        if seen.mask is None:
            return _fitted(view, network, seen.lines, parameters, counts)
        mask = from_above(view, seen).astype(np.uint8)
        return find_lines(
            view, picture.image, parameters, prior_shape=prior, on_road=counts, mask=mask
        )

    return find


def _fitted(
    view: BirdsEye,
    network: Network,
    lines: tuple[Line, ...],
    parameters: Parameters,
    counts: BoolArray | None,
) -> Found:
    """Fit each line by least squares over its places in the view. Of lines nearer to each other
    than `APART_M`, the most probable is kept."""
    valid = view.valid if counts is None else view.valid & counts
    shapes: list[FloatArray] = []
    kept: list[Line] = []
    for line in sorted(lines, key=lambda line: -line.probability):
        shape = _shape(view, valid, line, CURVES[str(parameters["curve"])])
        if shape is None or abs(shape[0]) > number(parameters, "side_m"):
            continue
        gaps = (np.array(shapes).reshape(-1, 4) - shape) @ powers(_COMPARED_M)
        if (np.abs(gaps) >= APART_M).all():
            shapes.append(shape)
            kept.append(line)
    found = np.array(shapes).reshape(-1, 4)
    order = np.argsort(found[:, 0], kind="stable")
    # NaN where no class says whether the line is continuous.
    told = [network.continuous.get(-1 if line.kind is None else line.kind, np.nan) for line in kept]
    solid = np.array(told, dtype=np.float64)[order]
    likely = np.array([line.probability for line in kept])[order]
    return Found(found[order], likely, likely=likely, solid=solid)


def _shape(view: BirdsEye, valid: BoolArray, line: Line, n: int) -> FloatArray | None:
    """The shape (4,) of a line, with n values that are not 0; None if too little of it is in the
    view."""
    x, y = image_to_road(view.camera, *line.points.T)
    # What is above the horizon or much farther than a view has no place in it.
    near = np.isfinite(x) & (x > 0) & (x < _FARTHEST_M) & (np.abs(y) < _ASIDE_M)
    x, y = x[near], y[near]
    order = np.argsort(x)
    at = np.arange(view.x_m[-1], view.x_m[0], _STEP_M)
    at = at[(at >= x.min(initial=np.inf)) & (at <= x.max(initial=-np.inf))]
    place = np.interp(at, x[order], y[order]) if len(at) else at
    row = ((view.x_m[0] - at) / view.along_m).astype(np.int64)
    column = np.round((place - view.y_m[0]) / view.across_m).astype(np.int64)
    inside = (column >= 0) & (column < valid.shape[1])
    inside &= valid[row, np.where(inside, column, 0)]
    if inside.sum() * _STEP_M < _LEAST_M:
        return None
    weight = (_NEAR_SD_M + _SD_PER_M * at[inside]) ** -2
    design = powers(at[inside])[:, :n]
    normal = design.T @ (design * weight[:, None]) + np.diag(_USUAL[:n])
    shape = np.zeros(4)
    shape[:n] = np.linalg.solve(normal, design.T @ (weight * place[inside]))
    return shape
