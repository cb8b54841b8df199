"""Estimate the camera's pitch from the lines of the road, and correct a calibration that is off.

With a wrong pitch the lines of a road converge or diverge in the bird's-eye view, and the line
finder, which searches for parallel lines, finds fewer of them. So some pictures are searched with
three pitches, the estimated one and one to either side. The pitch that shows most line is likely,
and the squeeze of its lines (see `fit`) gives the remaining error. The posterior over pitches is
kept on a grid and forgets slowly, so that it follows a camera that was moved.

The car's pitching and the slope of the road move the lines in the same way. The posterior is
therefore about the mean pitch, and its standard deviation includes this sway.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.parameters import Parameter, Parameters
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.fit import find_lines

PARAMETERS = (
    Parameter(
        "camera_drift",
        "choice",
        "correct",
        "if the pitch of the camera differs from its calibration: `correct` it and warn once, or"
        " `ignore` it",
        choices=("correct", "ignore"),
    ),
)

#: Number of first pictures that are all checked.
_FIRST = 10

#: Factor from one waiting time to the next after the first pictures.
_SLOWER = 1.1

#: The longest waiting time, frames: a check takes as long as three frames.
_EVERY = 50

#: The pitch is off if it differs by more than this and two standard deviations, degrees.
_DRIFT_DEG = 0.3

#: Number of checks before the pitch can be off.
_LEAST_CHECKS = 6

#: Step of the corrections of the pitch, degrees.
_CORRECTION_DEG = 0.1

#: Grid of differences from the calibrated pitch, degrees, and the log of their prior probabilities
#: up to a constant (standard deviation 1 degree).
_GRID = np.linspace(-3.0, 3.0, 121)
_PRIOR = -0.5 * _GRID**2

#: Distance of the three pitches of a check, degrees.
_APART_DEG = 0.75

#: Step that the pitches of a check are rounded to, degrees.
_STEP_DEG = 0.25

#: Share of the earlier evidence that is kept at a check.
_KEPT = 0.9

#: Sway of the pitch by car and road, degrees.
_SWAY_DEG = 0.25

#: Number of frames over which the sway averages out.
_SWAY_FRAMES = 100

#: Gain in log-likelihood of a pitch per additional line of full length.
_PER_LINE = 2.0

#: Standard deviation of the pitch that follows from the squeeze, degrees.
_SQUEEZE_DEG = 0.5

#: Number of these standard deviations at which the log-likelihood stops falling, because the lines
#: may be something else.
_MOST_SDS = 2.0

#: Least spread of the lines of a squeeze, metres.
_LEAST_SPREAD_M = 2.0


@dataclass(frozen=True)
class Drift:
    """The posterior over the camera's pitch.

    - weight: (G,) probability of each difference from the calibrated pitch
    - frames: number of pictures so far
    - checks: number of them that were checked and showed a line
    - is_off: True once the pitch has differed significantly from the calibrated one
    """

    weight: FloatArray
    frames: int = 0
    checks: int = 0
    is_off: bool = False

    @property
    def pitch_deg(self) -> float:
        """The mean difference from the calibrated pitch, degrees, up is positive."""
        return float(self.weight @ _GRID)

    @property
    def pitch_sd_deg(self) -> float:
        """The standard deviation of that difference, degrees, sway included."""
        variance = float(self.weight @ (_GRID - self.pitch_deg) ** 2)
        return math.sqrt(variance + _SWAY_DEG**2 / (1 + self.frames / _SWAY_FRAMES))

    @property
    def correction_deg(self) -> float:
        """The correction of the pitch, degrees, in steps, because a new view takes longer than a
        picture. It is 0 until the pitch is off significantly: an estimate after a second would make
        a good calibration worse."""
        if not self.is_off:
            return 0.0
        return round(self.pitch_deg / _CORRECTION_DEG) * _CORRECTION_DEG


def watch(view: BirdsEye, parameters: Parameters) -> Callable[[Picture], Drift]:
    """Make a function to call with each picture of a drive, which returns the posterior.

    It checks some of the pictures, and warns once of a drift. view: with the calibrated camera.
    """
    camera = view.camera
    turned = turned_up(view)
    drift = Drift(_normalised(_PRIOR))
    n_checks = 0
    next_check = 0

    def tried(image: Image, away: float) -> tuple[float, float]:
        """Return the length of line at a pitch, and the pitch at which the lines are parallel, NaN
        if unknown."""
        try:
            found = find_lines(turned(away), image, parameters)
        except InputError:
            # With this pitch the camera would not show the road.
            return 0.0, math.nan
        offset = found.shape[:, 0]
        heading = found.shape[:, 1]
        if len(offset) < 2 or np.ptp(offset) < _LEAST_SPREAD_M:
            return float(found.score.sum()), math.nan
        squeeze = float(np.polyfit(offset, heading, 1)[0])
        return float(found.score.sum()), away - math.degrees(squeeze * camera.height_m)

    def see(picture: Picture) -> Drift:
        nonlocal drift, n_checks, next_check
        n = drift.frames
        drift = replace(drift, frames=n + 1)
        if n < next_check:
            return drift
        n_checks += 1
        wait = 1.0 if n_checks < _FIRST else _SLOWER ** min(n_checks - _FIRST, 200)
        next_check = n + round(min(wait, _EVERY))
        middle = round(drift.pitch_deg / _STEP_DEG) * _STEP_DEG
        away = middle + _APART_DEG * np.array([-1.0, 0.0, 1.0])
        amount, parallel = zip(*(tried(picture.image, a) for a in away), strict=True)
        if not any(amount):
            return drift
        drift = _updated(drift, away, np.array(amount), parallel[int(np.argmax(amount))])
        limit = _DRIFT_DEG + 2 * drift.pitch_sd_deg
        if not drift.is_off and drift.checks >= _LEAST_CHECKS and abs(drift.pitch_deg) > limit:
            drift = replace(drift, is_off=True)
            warnings.warn(
                f"frame {picture.frame_id}: {camera.name or 'the camera'}: the lines of the road"
                f" show a pitch of {camera.pitch_deg + drift.pitch_deg:.2f} degrees (standard"
                f" deviation {drift.pitch_sd_deg:.2f}), but it was calibrated with pitch_deg"
                f" {camera.pitch_deg:.2f}; the pitch is corrected from here on",
                stacklevel=2,
            )
        return drift

    return see


def _updated(drift: Drift, away: FloatArray, amount: FloatArray, parallel_deg: float) -> Drift:
    """Update the posterior with the length of line (3,) at three pitches (3,), and the pitch at
    which the lines are parallel, NaN if unknown; pitches are differences from the calibrated one.
    """
    log_weight = _KEPT * np.log(np.maximum(drift.weight, 1e-12)) + (1 - _KEPT) * _PRIOR
    parabola = np.polyfit(away, amount, 2)
    log_weight += _PER_LINE * np.polyval(parabola, np.clip(_GRID, away[0], away[2]))
    if math.isfinite(parallel_deg):
        sds = np.minimum(np.abs(_GRID - parallel_deg) / _SQUEEZE_DEG, _MOST_SDS)
        log_weight -= 0.5 * sds**2
    return replace(drift, weight=_normalised(log_weight), checks=drift.checks + 1)


def _normalised(log_weight: FloatArray) -> FloatArray:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())
