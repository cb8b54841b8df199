"""Find the lines of the road with a network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors import fit_shape, powers
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.layouts import Line, answer
from egolane_pgm.vision.detectors.networks.running import fit_of, load
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, look
from egolane_pgm.vision.detectors.simple.finder import Finder
from egolane_pgm.vision.detectors.simple.fit import APART_M, Found, find_lines
from egolane_pgm.vision.detectors.simple.parameters import CURVES

#: Points of lines farther ahead are left out, metres.
_FARTHEST_M = 150.0

#: Points of lines farther to the side are left out, metres.
_ASIDE_M = 100.0

#: The shortest line that is fitted, metres.
_LEAST_M = 3.0

#: Distance between the positions of a fitted line, metres.
_STEP_M = 1.0

#: Distance ahead at which lines are compared, metres.
_COMPARED_M = 10.0

#: Standard deviations of offset, heading (m/m), curvature (1/m) and its rate (1/m^2) around 0.
_USUAL = (np.inf, 0.05, 0.001, 4e-5)

#: Standard deviation of a position next to the car, metres.
_NEAR_SD_M = 0.05

#: Growth of a position's standard deviation per metre ahead.
_SD_PER_M = 0.01


def looker(network: Network, camera: Camera) -> Callable[[Picture], Image | list[Line]]:
    """Make the function from a picture to the network's answer. Raises InputError as `load`."""
    fit = fit_of(network, camera.width, camera.height)
    run = load(network, fit)
    return lambda picture: answer(network, fit, run(picture.image))


def network_finder(camera: Camera, network: Network, parameters: Parameters) -> Finder:
    """Make the function that finds the lines of a network. Raises InputError as `load` does."""
    see = looker(network, camera)

    def find(view: BirdsEye, picture: Picture, prior: FloatArray | None) -> Found:
        seen = see(picture)
        if isinstance(seen, list):
            return _fitted(view, network, seen, parameters)
        mask = ((look(view, seen) > 127) & view.valid).astype(np.uint8)
        return find_lines(view, picture.image, parameters, prior_shape=prior, mask=mask)

    return find


def _fitted(view: BirdsEye, network: Network, lines: list[Line], parameters: Parameters) -> Found:
    """Fit each line by least squares over its positions in the view. Of lines nearer to each other
    than `APART_M`, the most probable is kept."""
    rows: list[FloatArray] = []
    for line in sorted(lines, key=lambda line: -line.probability):
        shape = _shape(view, line, CURVES[str(parameters["curve"])])
        if shape is None or abs(shape[0]) > number(parameters, "side_m"):
            continue
        if all(abs((row[:4] - shape) @ powers(_COMPARED_M)) >= APART_M for row in rows):
            solid = network.continuous.get(-1 if line.kind is None else line.kind, np.nan)
            rows.append(np.array([*shape, line.probability, solid]))
    found = np.array(rows).reshape(-1, 6)
    found = found[np.argsort(found[:, 0], kind="stable")]
    return Found(found[:, :4], score=found[:, 4], likely=found[:, 4], solid=found[:, 5])


def _shape(view: BirdsEye, line: Line, n: int) -> FloatArray | None:
    """Return the shape (4,) of a line, with n values that are not 0; None if too little of it is in
    the view."""
    x, y = image_to_road(view.camera, *line.points.T)
    # Points above the horizon are not on the road.
    near = np.isfinite(x) & (x > 0) & (x < _FARTHEST_M) & (np.abs(y) < _ASIDE_M)
    x = x[near]
    y = y[near]
    order = np.argsort(x)
    at = np.arange(view.x_m[-1], view.x_m[0], _STEP_M)
    at = at[(at >= x.min(initial=np.inf)) & (at <= x.max(initial=-np.inf))]
    offset = np.interp(at, x[order], y[order]) if len(at) else at
    row = ((view.x_m[0] - at) / view.along_m).astype(np.int64)
    column = np.round((offset - view.y_m[0]) / view.across_m).astype(np.int64)
    inside = (column >= 0) & (column < len(view.y_m))
    inside &= view.valid[row, np.where(inside, column, 0)]
    if inside.sum() * _STEP_M < _LEAST_M:
        return None
    sd_m = _NEAR_SD_M + _SD_PER_M * at[inside]
    return fit_shape(at[inside], offset[inside], sd_m, _USUAL[:n])
