"""A simulated line detector and tracker, which fails in bursts.

Every line of the road has a track. In each frame a track is detected or not. The line reliability
index (LRI) counts its detections in the last frames. The line becomes valid when the LRI reaches
its maximum, and stays so until the LRI falls below a share of it (paper, section
`section:simple-line-detector`). Between detections a track keeps its last offset, as the recorded
trackers do.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass
from scipy.special import ndtr

from egolane_pgm.simulation.world import NotNegative, Positive, Road, Share, slow_noise
from egolane_pgm.types import BoolArray, FloatArray, IntArray, LineLog

#: Correlation times of the noise and of the continuous flag, and the mean duration of a false
#: track, seconds.
_NOISE_S, _FLAG_S, _CLUTTER_S = 0.7, 0.5, 2.0

#: The width of the fall of visibility with distance (logistic), and the standard deviation of the
#: shift of lines in a failure, metres.
_RANGE_SOFTNESS_M, _BAD_SHIFT_M = 1.0, 2.5

#: The number of frames over which detections are counted, and the share of it below which a valid
#: line stops being valid.
_LRI_MAX, _LRI_RESET = 10, 0.1


@checked_dataclass(frozen=True)
class DetectorModel:
    """How lines are detected; probabilities are per line and frame unless said otherwise.

    Reported offsets:

    - offset_scale: reported over true offset (an error of the camera's calibration)
    - noise_m: standard deviation of a reported line from its place

    Detections:

    - seen_left, seen_inner, seen_right, seen_shoulder: probability that a near line is in view: the
      leftmost line, an inner (dashed) one, the rightmost one, the line beyond the shoulder
    - range_m: distance at which a line is in view half as often
    - in_view_s: correlation time of being in view, seconds
    - miss: probability that a line in view is missed in a frame

    Flags:

    - continuous_left, continuous_inner, continuous_right, continuous_shoulder: probability that the
      line has the continuous flag

    False lines:

    - clutter_lines: the largest number of false tracks at once
    - clutter: share of the time for which each of them is there
    - clutter_range_m: the largest distance of a false track to either side

    Failures, from a Markov chain with the states OK and BAD:

    - ok_s, bad_s: mean time in each state, seconds; bad_s = 0 for no failures
    - bad_missed: probability, per line and failure, that the line is not detected
    - bad_shifted: probability, per line and failure, that the line is reported shifted; all lines
      of a failure share the shift
    - bad_clutter: probability, per false track and failure, that the track is there
    """

    offset_scale: Positive = 1.0
    noise_m: NotNegative = 0.16
    seen_left: Share = 0.97
    seen_inner: Share = 0.97
    seen_right: Share = 0.95
    seen_shoulder: Share = 0.5
    range_m: Positive = 8.0
    in_view_s: NotNegative = 2.0
    miss: Share = 0.02
    continuous_left: Share = 0.78
    continuous_inner: Share = 0.02
    continuous_right: Share = 0.37
    continuous_shoulder: Share = 0.3
    clutter_lines: Annotated[int, Field(ge=0, le=100)] = 2
    clutter: Annotated[float, Field(ge=0, lt=1)] = 0.05
    clutter_range_m: NotNegative = 10.0
    ok_s: Positive = 20.0
    bad_s: NotNegative = 4.0
    bad_missed: Share = 0.6
    bad_shifted: Share = 0.5
    bad_clutter: Share = 0.5


def _stretches(
    rng: np.random.Generator, n_frames: int, off_frames: float, on_frames: float
) -> tuple[BoolArray, IntArray]:
    """A stationary two-state Markov chain: whether it is on, (T,), and the number of the stretch
    that a frame belongs to, (T,).

    off_frames, on_frames: mean lengths of the stretches, raised to 1 frame; on_frames = 0 for a
    chain that is never on.
    """
    if on_frames == 0:
        return np.zeros(n_frames, dtype=bool), np.zeros(n_frames, dtype=np.int64)
    mean = np.maximum(1.0, np.array([off_frames, on_frames]))
    state = int(rng.random() < mean[1] / mean.sum())
    lengths: list[int] = []
    covered = 0
    while covered < n_frames:
        # A geometric length has no memory, so the rest of the first stretch is geometric as well.
        lengths.append(int(rng.geometric(1.0 / mean[(state + len(lengths)) % 2])))
        covered += lengths[-1]
    number = np.repeat(np.arange(len(lengths)), lengths)[:n_frames]
    return (number + state) % 2 == 1, number


def sensor_failures(detector: DetectorModel, road: Road, seed: int) -> BoolArray:
    """The frames in which the sensor fails, (T,): a Markov chain that starts in equilibrium."""
    rng = np.random.default_rng([seed, 1])
    rate = road.frame_rate
    return _stretches(rng, len(road), detector.ok_s * rate, detector.bad_s * rate)[0]


def _slow_events(
    rng: np.random.Generator, probability: FloatArray, correlation_frames: float
) -> BoolArray:
    """Events (T, K) of the given probabilities (T, K) that are correlated over time."""
    noise = slow_noise(rng, len(probability), probability.shape[1], correlation_frames)
    grid = np.linspace(-6.0, 6.0, 1201)
    return np.asarray(noise < np.interp(probability, ndtr(grid), grid))


def _road_tracks(
    road: Road, detector: DetectorModel, is_failing: BoolArray, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Offsets, detections and continuous flags, (T, K) each, of the road's own lines."""
    true_m = np.column_stack([road.line_offset_m, road.shoulder_offset_m])
    exists = np.isfinite(true_m)
    true_m = np.where(exists, true_m, 0.0)
    n_frames, n_tracks = true_m.shape
    # Lanes may begin and end along the road: its first and its last line are those that are there.
    number, of_road = np.arange(n_tracks), exists[:, :-1]
    first = of_road.argmax(axis=1)[:, None]
    last = (n_tracks - 2 - of_road[:, ::-1].argmax(axis=1))[:, None]

    def per_line(left: float, middle: float, right: float, shoulder: float) -> FloatArray:
        of_line = np.where(number == first, left, np.where(number == last, right, middle))
        return np.where(number == n_tracks - 1, shoulder, of_line)

    fps = road.frame_rate
    seen = per_line(
        detector.seen_left, detector.seen_inner, detector.seen_right, detector.seen_shoulder
    )
    excess = np.clip((np.abs(true_m) - detector.range_m) / _RANGE_SOFTNESS_M, -50, 50)
    in_view = _slow_events(rng, seen / (1.0 + np.exp(excess)), detector.in_view_s * fps)
    is_detected = in_view & exists & (rng.random(true_m.shape) >= detector.miss)
    flag = per_line(
        detector.continuous_left,
        detector.continuous_inner,
        detector.continuous_right,
        detector.continuous_shoulder,
    )
    is_continuous = _slow_events(rng, flag, _FLAG_S * fps)
    noise = detector.noise_m * slow_noise(rng, n_frames, n_tracks, _NOISE_S * fps)

    # Drawn once for each stretch between failures or in one.
    stretch = np.cumsum(np.diff(is_failing, prepend=is_failing[:1]))
    n_stretches = int(stretch[-1]) + 1
    missed = (rng.random((n_stretches, n_tracks)) < detector.bad_missed)[stretch]
    shifted = (rng.random((n_stretches, n_tracks)) < detector.bad_shifted)[stretch]
    shift = _BAD_SHIFT_M * rng.standard_normal(n_stretches)[stretch]
    is_detected &= ~(is_failing[:, None] & missed)
    moved = np.where(is_failing[:, None] & shifted, shift[:, None], 0.0)
    return detector.offset_scale * true_m + noise + moved, is_detected, is_continuous


def _clutter_tracks(
    road: Road, detector: DetectorModel, is_failing: BoolArray, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Offsets, detections and continuous flags, (T, K) each, of the false lines."""
    n_frames, fps, n_tracks = len(road), road.frame_rate, detector.clutter_lines
    offset = detector.noise_m * slow_noise(rng, n_frames, n_tracks, _NOISE_S * fps)
    is_detected = np.zeros((n_frames, n_tracks), dtype=bool)
    stretch = np.cumsum(np.diff(is_failing, prepend=is_failing[:1]))
    in_failure = (rng.random((int(stretch[-1]) + 1, n_tracks)) < detector.bad_clutter)[stretch]
    on = _CLUTTER_S * fps if detector.clutter else 0.0
    off = on * (1 - detector.clutter) / detector.clutter if detector.clutter else 1.0
    for k in range(n_tracks):
        is_there, _ = _stretches(rng, n_frames, off, on)
        is_there = np.where(is_failing, in_failure[:, k], is_there)
        appearance = np.cumsum(is_there & ~np.r_[False, is_there[:-1]])
        places = rng.uniform(-1.0, 1.0, int(appearance.max(initial=0)) + 1)
        offset[:, k] += detector.clutter_range_m * places[appearance]
        is_detected[:, k] = is_there & (rng.random(n_frames) >= detector.miss)
    is_continuous = _slow_events(
        rng, np.full((n_frames, n_tracks), detector.continuous_inner), _FLAG_S * fps
    )
    return offset, is_detected, is_continuous


def _last_frame_with(event: BoolArray) -> IntArray:
    """The last frame up to now with the event, (T, K); -1 before the first."""
    frame = np.arange(len(event))[:, None]
    return np.asarray(np.maximum.accumulate(np.where(event, frame, -1), axis=0))


def line_reliability(
    is_detected: BoolArray, lri_max: int, lri_reset: float
) -> tuple[IntArray, BoolArray]:
    """LRI and valid flags, (T, K) each, of tracks with detections (T, K).

    The LRI is the number of detections in the last lri_max frames; frames before the first count as
    the first one. A track is valid from LRI = lri_max until LRI < lri_reset lri_max or LRI = 0.
    """
    first = np.repeat(is_detected[:1], lri_max, axis=0)
    total = np.cumsum(np.concatenate([first, is_detected]), axis=0)
    lri = total[lri_max:] - total[:-lri_max]
    lost = (lri < lri_reset * lri_max) | (lri == 0)
    return lri, _last_frame_with(lri == lri_max) > _last_frame_with(lost)


def detect_lines(road: Road, is_failing: BoolArray, detector: DetectorModel, seed: int) -> LineLog:
    """The lines that `detector` reports on `road`; the same seed gives the same log.

    is_failing: (T,) the frames in which the sensor fails, for example from `sensor_failures`.

    Each frame lists, from left to right, the lines detected within the last ten frames.
    """
    rng = np.random.default_rng([seed, 2])
    tracks = [
        _road_tracks(road, detector, is_failing, rng),
        _clutter_tracks(road, detector, is_failing, rng),
    ]
    offset, is_detected, is_continuous = (
        np.concatenate(parts, axis=1) for parts in zip(*tracks, strict=True)
    )
    lri, is_valid = line_reliability(is_detected, _LRI_MAX, _LRI_RESET)
    is_listed = lri > 0
    last = np.maximum(_last_frame_with(is_detected), 0)
    offset = np.where(is_listed, np.take_along_axis(offset, last, axis=0), np.nan)
    is_continuous = np.take_along_axis(is_continuous, last, axis=0) & is_listed

    n_slots = max(1, int(is_listed.sum(axis=1).max()))
    order = np.argsort(offset, axis=1, kind="stable")[:, :n_slots]  # NaN last
    frame_id = np.arange(len(road), dtype=np.int64)
    return LineLog(
        frame_id,
        frame_id / road.frame_rate,
        np.take_along_axis(offset, order, axis=1),
        np.take_along_axis(is_valid & is_listed, order, axis=1),
        np.take_along_axis(is_continuous, order, axis=1),
        np.take_along_axis(np.where(is_listed, lri, np.nan), order, axis=1),
        source="simulated line detector",
    )
