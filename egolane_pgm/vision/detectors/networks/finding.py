"""The lines of a frame, as a network sees them: those that it gives itself, each fitted alone, or
those that are found in its mask."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import powers
from egolane_pgm.vision.detectors.networks.answers import Answer, Line
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.layouts import from_above, on_road
from egolane_pgm.vision.detectors.networks.looking import looker
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines
from egolane_pgm.vision.detectors.simple.parameters import CURVES

#: The shortest line that is fitted, metres ahead, and the distance of its places.
_LEAST_M, _STEP_M = 3.0, 1.0

#: Where lines are compared, metres ahead.
_COMPARED_M = 10.0

#: Weights of 0 for offset, heading (m/m), curvature (1/m) and its rate (1/m^2): one over the square
#: of what is usual.
_USUAL = np.array([0.0, 0.05**-2, 0.001**-2, 4e-5**-2])

#: Standard deviation of a place, metres, and how much more for each metre ahead.
_NEAR_SD_M, _SD_PER_M = 0.05, 0.01


#: Takes a bird's-eye view, a picture, the lines expected in it (P, 4) or None, and which pixels of
#: the view count, (R, C) or None; gives None for a picture that is not looked at.
Finder = Callable[[BirdsEye, Picture, FloatArray | None, BoolArray | None], Found | None]


def network_finder(camera: Camera, network: Network, parameters: Parameters) -> Finder:
    """Makes the function that finds the lines of a network. Raises InputError as `load` does."""
    look = looker(network, camera)

    def find(
        view: BirdsEye, picture: Picture, prior: FloatArray | None, counts: BoolArray | None
    ) -> Found | None:
        seen = look(picture)
        if seen is None:
            return None
        if seen.mask is None:
            return fitted(view, network, seen, parameters, counts)
        mask = from_above(view, seen)
        return find_lines(
            view, picture.image, parameters, prior_shape=prior, on_road=counts, mask=mask
        )

    return find


def fitted(
    view: BirdsEye,
    network: Network,
    seen: Answer,
    parameters: Parameters,
    counts: BoolArray | None = None,
) -> Found:
    """Fits each line of an answer by least squares over its places in the view. Of lines nearer to
    each other than `apart_m`, the most probable is kept.

    - counts: (R, C) the pixels of the view that count; None for all
    """
    valid = view.valid if counts is None else view.valid & counts
    shapes: list[FloatArray] = []
    kept: list[Line] = []
    for line in sorted(seen.lines, key=lambda line: -line.probability):
        shape = _fitted(view, valid, *on_road(view.camera, seen, line), str(parameters["curve"]))
        if shape is None or abs(shape[0]) > number(parameters, "side_m"):
            continue
        gaps = (np.array(shapes).reshape(-1, 4) - shape) @ powers(_COMPARED_M)
        if (np.abs(gaps) >= number(parameters, "apart_m")).all():
            shapes.append(shape)
            kept.append(line)
    found = np.array(shapes).reshape(-1, 4)
    order = np.argsort(found[:, 0], kind="stable")
    told = [network.continuous.get(-1 if line.kind is None else line.kind) for line in kept]
    solid = np.array([np.nan if each is None else each for each in told], dtype=np.float64)
    likely = np.array([line.probability for line in kept])[order]
    return Found(found[order], likely, likely=likely, solid=solid[order])


def _fitted(
    view: BirdsEye, valid: BoolArray, x: FloatArray, y: FloatArray, curve: str
) -> FloatArray | None:
    """The shape (4,) of the line through places (P,), None if too few of them are in the view."""
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
    n = CURVES[curve]
    weight = (_NEAR_SD_M + _SD_PER_M * at[inside]) ** -2
    design = powers(at[inside])[:, :n]
    normal = design.T @ (design * weight[:, None]) + np.diag(_USUAL[:n])
    shape = np.zeros(4)
    shape[:n] = np.linalg.solve(normal, design.T @ (weight * place[inside]))
    return shape
