"""Watches the calibration: estimates the camera's pitch from the lines that it sees.

A wrong pitch makes the lines of a road meet or spread in the bird's-eye view, and the line finder,
which looks for parallel lines, finds fewer of them. So every now and then a picture is looked at
with three pitches, the one believed in and one to either side of it. The pitch that shows most line
is the likely one, and how far its lines are from parallel (the squeeze of `fit`) says how much is
missing. The belief over pitches is kept on a grid. It forgets slowly, so that it follows a camera
that was moved.

The car's own pitching and the slope of the road move the lines in the same way. The belief is
therefore about the pitch on the average, and its standard deviation tells how far the average can
be trusted.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.parameters import Parameter, Parameters
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image, Picture
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.fit import (
    Found,
    find_lines,
)

PARAMETERS = (
    Parameter(
        "camera_drift",
        "choice",
        "correct",
        "what is done if the camera is no longer pitched as it was calibrated: `correct` the pitch"
        " and warn once (with two cameras the plane of the road corrects it), `warn` only, or"
        " `ignore` it and save the time to look",
        choices=("correct", "warn", "ignore"),
    ),
)

#: The most frames between two looks at the calibration; each takes as long as three frames.
_EVERY = 50

#: The pitch has drifted if it is off by more than this and two standard deviations, degrees.
_DRIFT_DEG = 0.3

#: The differences from the calibrated pitch that the belief is about, degrees.
_GRID = np.linspace(-3.0, 3.0, 121)

#: Standard deviation of that difference before the first picture, degrees.
_USUAL_DEG = 1.0

#: The logarithm of their probabilities before the first picture, up to a constant.
_PRIOR = -0.5 * (_GRID / _USUAL_DEG) ** 2

#: The distance between the three pitches of a look, and the step that they are rounded to, degrees.
_APART_DEG, _STEP_DEG = 0.75, 0.25

#: The share of the earlier evidence that is kept at one more look.
_KEPT = 0.9

#: How much the car and the rise of the road sway the pitch, degrees, and over how many frames.
_SWAY_DEG, _SWAY_FRAMES = 0.25, 100

#: The log-likelihood that a pitch gains with one more line in full.
_PER_LINE = 2.0

#: Standard deviation of the pitch that follows from the lines' squeeze, degrees. A pitch farther
#: away than this number of them counts no less: what looked like lines was something else.
_SQUEEZE_DEG, _MOST_SDS = 0.5, 2.0

#: The least distance of the outer lines, metres, from which a squeeze follows.
_LEAST_SPREAD_M = 2.0

#: Number of first pictures that are all looked at, and the factor by which each later look makes
#: the wait for the next one longer: a warning may take more time than a correction.
_FIRST, _SLOWER = 10, {"correct": 1.1, "warn": 1.5}

#: The fewest looks before anything is said of the camera.
_LEAST_LOOKS = 6

#: The steps in which the pitch is corrected, degrees.
_CORRECTION_DEG = 0.1


@dataclass(frozen=True)
class Drift:
    """The belief about a camera's pose after some looks.

    - weight: (G,) probability of each of the differences from the calibrated pitch
    - frames: how many pictures the drive has had so far
    - looks: how many of them were looked at and showed a line
    - is_off: whether the pitch has differed from the calibrated one for sure
    """

    weight: FloatArray
    frames: int
    looks: int
    is_off: bool = False

    @property
    def pitch_deg(self) -> float:
        """The mean difference from the calibrated pitch, degrees, up is positive."""
        return float(self.weight @ _GRID)

    @property
    def pitch_sd_deg(self) -> float:
        """Its standard deviation, degrees: that of the belief and that of the sway together."""
        variance = float(self.weight @ (_GRID - self.pitch_deg) ** 2)
        return math.sqrt(variance + _SWAY_DEG**2 / (1 + self.frames / _SWAY_FRAMES))


def no_drift() -> Drift:
    """The belief before the first look: the calibration is roughly right."""
    return Drift(_normalised(_PRIOR), 0, 0)


def _normalised(log_weight: FloatArray) -> FloatArray:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def looked(drift: Drift, away: FloatArray, amount: FloatArray, parallel_deg: float) -> Drift:
    """The belief after one more look.

    - away: (3,) the pitches that were tried, as differences from the calibrated one, ascending
    - amount: (3,) the length of line that each shows, in lines seen in full
    - parallel_deg: the pitch at which the lines are parallel; NaN where it is unknown
    """
    log_weight = _KEPT * np.log(np.maximum(drift.weight, 1e-12)) + (1 - _KEPT) * _PRIOR
    parabola = np.polyfit(away, amount, 2)
    log_weight += _PER_LINE * np.polyval(parabola, np.clip(_GRID, away[0], away[2]))
    if math.isfinite(parallel_deg):
        sds = np.minimum(np.abs(_GRID - parallel_deg) / _SQUEEZE_DEG, _MOST_SDS)
        log_weight -= 0.5 * sds**2
    return replace(drift, weight=_normalised(log_weight), looks=drift.looks + 1)


def parallel_at(view: BirdsEye, found: Found) -> float:
    """By how much the view's pitch would have to be larger for the lines to be parallel, degrees;
    NaN where there are no two lines."""
    offset, heading = found.shape[:, 0], found.shape[:, 1]
    if len(offset) < 2 or np.ptp(offset) < _LEAST_SPREAD_M:
        return float("nan")
    squeeze = float(np.polyfit(offset, heading, 1)[0])
    return -math.degrees(squeeze * view.camera.height_m)


def watch(view: BirdsEye, parameters: Parameters) -> Callable[[Picture], Drift]:
    """Makes a function to call with each picture of a drive. It looks at some of the pictures,
    gives the belief about the camera, and warns once of a drift.

    view: the bird's-eye view of the calibrated camera.
    """
    drift, n_looks, next_look = no_drift(), 0, 0
    turned = turned_up(view)

    def tried(image: Image, away: float) -> tuple[float, float]:
        try:
            seen = turned(away)
        except InputError:
            # So far off that the camera would not see the road.
            return 0.0, float("nan")
        found = find_lines(seen, image, parameters)
        return float(found.score.sum()), away + parallel_at(seen, found)

    def see(picture: Picture) -> Drift:
        nonlocal drift, n_looks, next_look
        n = drift.frames
        drift = replace(drift, frames=n + 1)
        if n < next_look:
            return drift
        n_looks += 1
        next_look = n + round(min(_gap(n_looks, parameters), _EVERY))
        middle = round(drift.pitch_deg / _STEP_DEG) * _STEP_DEG
        away = middle + _APART_DEG * np.array([-1.0, 0.0, 1.0])
        amount, parallel = zip(*(tried(picture.image, a) for a in away), strict=True)
        if not any(amount):
            return drift
        best = int(np.argmax(amount))
        drift = looked(drift, away, np.array(amount), parallel[best])
        if not drift.is_off and _has_drifted(drift):
            drift = replace(drift, is_off=True)
            said = _complaint(view.camera, drift, str(parameters["camera_drift"]))
            warnings.warn(f"frame {picture.frame_id}: {said}", UserWarning, stacklevel=2)
        return drift

    return see


def _gap(n_looks: int, parameters: Parameters) -> float:
    """The number of frames before the next look."""
    if n_looks < _FIRST:
        return 1.0
    return _SLOWER[str(parameters["camera_drift"])] ** min(n_looks - _FIRST, 200)


def correction_deg(drift: Drift) -> float:
    """The correction of the pitch, degrees, in steps, because a new view of the road takes longer
    than a picture. A camera whose pitch has never been off for sure is left as it is: the belief
    after a second would correct a good one for the worse."""
    if not drift.is_off:
        return 0.0
    return round(drift.pitch_deg / _CORRECTION_DEG) * _CORRECTION_DEG


def _has_drifted(drift: Drift) -> bool:
    """Whether the pitch is off for sure."""
    return drift.looks >= _LEAST_LOOKS and (
        abs(drift.pitch_deg) > _DRIFT_DEG + 2 * drift.pitch_sd_deg
    )


def _complaint(camera: Camera, drift: Drift, choice: str) -> str:
    """The warning of a drift. choice: the value of `camera_drift`."""
    then = (
        "the pitch is corrected from here on"
        if choice == "correct"
        else "calibrate it again, or set the detector's camera_drift to correct"
    )
    return (
        f"{camera.name or 'the camera'}: the lines of the road say that it is pitched by"
        f" {camera.pitch_deg + drift.pitch_deg:.2f} degrees (standard deviation"
        f" {drift.pitch_sd_deg:.2f}), but it was calibrated with pitch_deg"
        f" {camera.pitch_deg:.2f}; {then}"
    )
