"""Coefficients of curves, in shares of the input's width and height: LSTR, PolyLaneNet and
BezierLaneNet."""

from __future__ import annotations

import numpy as np
import scipy
from scipy.ndimage import maximum_filter1d

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.detectors.networks.answers import Line, points
from egolane_pgm.vision.detectors.networks.description import POLYNOMIAL, Network
from egolane_pgm.vision.detectors.networks.running import Outputs

#: Where the points of a curve are, from its first to its last.
_STEPS = np.linspace(0, 1, 100)

#: Candidates beside a better one are left out (`local_maximum_window_size` of BezierLaneNet).
_WINDOW = 9


def lstr_curves(network: Network, outputs: Outputs) -> list[Line]:
    """LSTR: from the lower to the upper y, k'' / (y - f'')^2 + m'' / (y - f'') + n' + b'' y - b'''
    (equation 5 of Liu 2021)."""
    share = scipy.special.softmax(outputs["scores"], axis=1)[:, 1]
    kept = share >= network.threshold
    lower, upper, k, f, m, n, b, c = outputs["curves"][kept].T[:, :, None]
    y = lower + (upper - lower) * _STEPS
    # A curve may have its pole in view.
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - c
    return _lines(network, share[kept], x, y)


def polynomials(network: Network, outputs: Outputs) -> list[Line]:
    """PolyLaneNet: x is a polynomial of y, the highest power first; all lines reach as far up as
    the first (`share_top_y` of its lib/models.py)."""
    values = outputs["curves"].reshape(-1, POLYNOMIAL)
    share = scipy.special.expit(values[:, 0])
    kept = share >= network.threshold
    y = values[0, 1] + (values[kept, 2:3] - values[0, 1]) * _STEPS
    x = (values[kept, 3:, None] * y[:, None] ** np.arange(3, -1, -1)[:, None]).sum(axis=1)
    return _lines(network, share[kept], x, y)


def beziers(network: Network, outputs: Outputs) -> list[Line]:
    """BezierLaneNet: cubic Bezier curves by their four points (`inference` of its
    bezier_base.py)."""
    share = scipy.special.expit(outputs["scores"])
    kept = (share >= network.threshold) & (share == maximum_filter1d(share, _WINDOW))
    power, t = np.arange(4), _STEPS[:, None]
    bernstein = scipy.special.comb(3, power) * t**power * (1 - t) ** (3 - power)
    x, y = np.moveaxis(bernstein @ outputs["curves"][kept], -1, 0)
    return _lines(network, share[kept], x, y)


def _lines(network: Network, share: FloatArray, x: FloatArray, y: FloatArray) -> list[Line]:
    """The lines through points (N, P), shares of the input's width and height."""
    width, height = network.size
    at = zip(x * width - 0.5, y * height - 0.5, share, strict=True)
    return [Line(points(u, v)[np.isfinite(u)], likely) for u, v, likely in at]
