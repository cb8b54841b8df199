"""A simulated line detector and tracker, which fails in bursts, and whole drives.

Every line of the road has a track. In each frame a track is detected or not. The line reliability
index (LRI) counts its detections in the last ten frames. The line becomes valid when the LRI
reaches ten, and stays so until it is zero (paper, section `section:simple-line-detector`). Between
detections a track keeps its last offset, as the recorded trackers do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass

from egolane_pgm.graphs.cpds import normal_cdf
from egolane_pgm.parameters import check_names
from egolane_pgm.simulation.world import (
    NotNegative,
    Positive,
    Road,
    Share,
    World,
    simulate_road,
    slow_noise,
)
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog, suggestion

#: Correlation time of the noise, seconds.
_NOISE_S = 0.7

#: Correlation time of the continuous flag, seconds.
_FLAG_S = 0.5

#: Mean duration of a false track, seconds.
_CLUTTER_S = 2.0

#: Width of the fall of visibility with distance (logistic), metres.
_RANGE_SOFTNESS_M = 1.0

#: Standard deviation of the shift of lines in a failure, metres.
_BAD_SHIFT_M = 2.5

#: The number of frames over which detections are counted.
_LRI_MAX = 10

#: The largest number of false tracks at once.
_CLUTTER_TRACKS = 2

#: The largest distance of a false track to either side, metres.
_CLUTTER_RANGE_M = 10.0

#: A table of the standard normal's cumulative distribution.
_GRID = np.linspace(-6.0, 6.0, 1201)
_CDF = normal_cdf(_GRID)


@checked_dataclass(frozen=True)
class DetectorModel:
    """The detection of lines; probabilities are per line and frame by default.

    - offset_scale: reported over true offset (an error of the camera's calibration)
    - noise_m: standard deviation of a reported line from its place
    - seen_left, seen_inner, seen_right, seen_shoulder: probability that a near line is in view: the
      leftmost line, an inner (dashed) one, the rightmost one, the line beyond the shoulder
    - range_m: distance that halves the probability of being in view
    - in_view_s: correlation time of being in view, seconds
    - miss: probability that a line in view is missed in a frame
    - continuous_left, continuous_inner, continuous_right, continuous_shoulder: probability that the
      line has the continuous flag
    - clutter: share of the time in which each of the two false tracks is present
    - ok_s, bad_s: mean time in the states OK and BAD of the sensor, a Markov chain, seconds;
      bad_s = 0 for no failures
    - bad_missed: probability, per line and failure, of no detection of the line
    - bad_shifted: probability, per line and failure, of a shift of the reported line; all lines
      of a failure share the shift
    - bad_clutter: probability, per false track and failure, of the presence of the track
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
    clutter: Annotated[float, Field(ge=0, lt=1)] = 0.05
    ok_s: Positive = 20.0
    bad_s: NotNegative = 4.0
    bad_missed: Share = 0.6
    bad_shifted: Share = 0.5
    bad_clutter: Share = 0.5


def _stretches(
    rng: np.random.Generator, n_frames: int, off_frames: float, on_frames: float
) -> BoolArray:
    """Return when a stationary two-state Markov chain is on, (T,).

    off_frames, on_frames: mean lengths of the stretches, raised to 1 frame; on_frames = 0 for a
    chain that is never on.
    """
    if on_frames == 0:
        return np.zeros(n_frames, dtype=bool)
    mean = np.maximum(1.0, np.array([off_frames, on_frames]))
    state = int(rng.random() < mean[1] / mean.sum())
    lengths: list[int] = []
    covered = 0
    while covered < n_frames:
        # A geometric length has no memory, so the rest of the first stretch is geometric as well.
        lengths.append(int(rng.geometric(1.0 / mean[(state + len(lengths)) % 2])))
        covered += lengths[-1]
    number = np.repeat(np.arange(len(lengths)), lengths)[:n_frames]
    return np.asarray((number + state) % 2 == 1)


def sensor_failures(detector: DetectorModel, road: Road, seed: int) -> BoolArray:
    """The frames in which the sensor fails, (T,): a Markov chain that starts in equilibrium."""
    rng = np.random.default_rng([seed, 1])
    rate = road.frame_rate
    return _stretches(rng, len(road.lane), detector.ok_s * rate, detector.bad_s * rate)


def _slow_events(
    rng: np.random.Generator, probability: FloatArray, correlation_frames: float
) -> BoolArray:
    """Events (T, K) of the given probabilities (T, K) that are correlated over time."""
    noise = slow_noise(rng, len(probability), probability.shape[1], correlation_frames)
    return np.asarray(noise < np.interp(probability, _CDF, _GRID))


def _road_tracks(
    road: Road, detector: DetectorModel, is_failing: BoolArray, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Offsets, detections and continuous flags, (T, K) each, of the road's own lines."""
    true_m = np.column_stack([road.line_offset_m, road.shoulder_offset_m])
    exists = np.isfinite(true_m)
    true_m = np.where(exists, true_m, 0.0)
    n_frames, n_tracks = true_m.shape
    # Lanes may begin and end along the road, so its outer lines are the outermost existing ones.
    number = np.arange(n_tracks)
    of_road = exists[:, :-1]
    first = of_road.argmax(axis=1)[:, None]
    last = (n_tracks - 2 - of_road[:, ::-1].argmax(axis=1))[:, None]
    # 0 the left line, 1 an inner one, 2 the right one, 3 the shoulder.
    role = np.where(number == first, 0, np.where(number == last, 2, 1))
    role[:, -1] = 3

    fps = road.frame_rate
    seen = np.array(
        [detector.seen_left, detector.seen_inner, detector.seen_right, detector.seen_shoulder]
    )[role]
    excess = np.clip((np.abs(true_m) - detector.range_m) / _RANGE_SOFTNESS_M, -50, 50)
    in_view = _slow_events(rng, seen / (1.0 + np.exp(excess)), detector.in_view_s * fps)
    is_detected = in_view & exists & (rng.random(true_m.shape) >= detector.miss)
    flags = [
        detector.continuous_left,
        detector.continuous_inner,
        detector.continuous_right,
        detector.continuous_shoulder,
    ]
    is_continuous = _slow_events(rng, np.array(flags)[role], _FLAG_S * fps)
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
    n_frames = len(is_failing)
    fps = road.frame_rate
    n_tracks = _CLUTTER_TRACKS
    offset = detector.noise_m * slow_noise(rng, n_frames, n_tracks, _NOISE_S * fps)
    is_detected = np.zeros((n_frames, n_tracks), dtype=bool)
    stretch = np.cumsum(np.diff(is_failing, prepend=is_failing[:1]))
    in_failure = (rng.random((int(stretch[-1]) + 1, n_tracks)) < detector.bad_clutter)[stretch]
    on = _CLUTTER_S * fps if detector.clutter else 0.0
    off = on * (1 - detector.clutter) / detector.clutter if detector.clutter else 1.0
    for k in range(n_tracks):
        is_there = _stretches(rng, n_frames, off, on)
        is_there = np.where(is_failing, in_failure[:, k], is_there)
        appearance = np.cumsum(is_there & ~np.r_[False, is_there[:-1]])
        places = rng.uniform(-1.0, 1.0, int(appearance.max(initial=0)) + 1)
        offset[:, k] += _CLUTTER_RANGE_M * places[appearance]
        is_detected[:, k] = is_there & (rng.random(n_frames) >= detector.miss)
    is_continuous = _slow_events(
        rng, np.full((n_frames, n_tracks), detector.continuous_inner), _FLAG_S * fps
    )
    return offset, is_detected, is_continuous


def line_reliability(is_detected: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return LRI and valid flags, (T, K) each, of tracks with detections (T, K).

    The LRI is the number of detections in the last ten frames; frames before the first count as the
    first one. A track is valid from LRI 10 until LRI 0.
    """
    first = np.repeat(is_detected[:1], _LRI_MAX, axis=0)
    total = np.cumsum(np.concatenate([first, is_detected]), axis=0)
    lri = total[_LRI_MAX:] - total[:-_LRI_MAX]
    state = pd.DataFrame(np.select([lri == _LRI_MAX, lri == 0], [1.0, 0.0], np.nan)).ffill()
    return lri, (state == 1).to_numpy()


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
    lri, is_valid = line_reliability(is_detected)
    is_listed = lri > 0
    held, flag = (
        pd.DataFrame(np.where(is_detected, values, np.nan)).ffill().to_numpy()
        for values in (offset, is_continuous)
    )
    offset = np.where(is_listed, held, np.nan)
    is_continuous = (flag == 1) & is_listed

    n_slots = max(1, int(is_listed.sum(axis=1).max()))
    order = np.argsort(offset, axis=1, kind="stable")[:, :n_slots]  # NaN last
    frame_id = np.arange(len(is_failing), dtype=np.int64)
    return LineLog(
        frame_id,
        frame_id / road.frame_rate,
        np.take_along_axis(offset, order, axis=1),
        np.take_along_axis(is_valid & is_listed, order, axis=1),
        np.take_along_axis(is_continuous, order, axis=1),
        np.take_along_axis(np.where(is_listed, lri, np.nan), order, axis=1),
        source="simulated line detector",
    )


@dataclass(frozen=True)
class SimulatedDrive:
    """A simulated drive: the recording and its annotation, and the simulator's hidden state.

    - log: the detected lines
    - truth: the annotated lane
    - position_m: (T,) distance of the vehicle from the leftmost line, metres
    - is_failing: (T,) True in the BAD state of the sensor
    """

    log: LineLog
    truth: pd.DataFrame
    n_lanes: int
    position_m: FloatArray
    is_failing: BoolArray

    def __len__(self) -> int:
        return len(self.log)


class Preset(NamedTuple):
    """A world and a detector."""

    world: World
    detector: DetectorModel


#: The presets by name.
PRESETS: Mapping[str, Preset] = {
    # Two minutes with failures that come often: the counting rule is right in .63, and the sensor
    # fails .32 of the time.
    "quickstart": Preset(
        World(),
        DetectorModel(
            noise_m=0.15,
            seen_left=0.99,
            seen_inner=0.99,
            seen_right=0.99,
            range_m=9.0,
            miss=0.005,
            clutter=0.02,
            ok_s=5.0,
            bad_s=2.5,
            bad_missed=0.75,
            bad_shifted=0.7,
        ),
    ),
    # Like the A4 in Italy seen by the paper's simple detectors: over seeds 0 to 9 the counting rule
    # (bonus value 7) is right in .60 of the non-crossing frames, .64 while the sensor is OK and .33
    # while it fails; it fails .14 of the time.
    "a4": Preset(
        World(
            n_lanes=4,
            lane_width_m=3.75,
            n_frames=9952,
            changes_per_minute=6.575,
            change_s=3.8,
            shoulder_m=3.3,
        ),
        DetectorModel(
            offset_scale=1.04,
            noise_m=0.15,
            seen_left=0.99,
            seen_inner=0.99,
            seen_right=0.99,
            seen_shoulder=0.35,
            range_m=9.0,
            in_view_s=3.0,
            miss=0.005,
            clutter=0.03,
            ok_s=22.0,
        ),
    ),
    # Like the A2 in Spain, with slow lane changes whose label flips at .65 of the crossing: the
    # counting rule is right in .69, .75 and .40; the sensor fails .15 of the time.
    "a2": Preset(
        World(
            lane_width_m=3.5,
            n_frames=9777,
            changes_per_minute=2.09,
            change_s=6.7,
            change_spread=0.15,
            crossing_share=0.85,
            label_flips_at=0.65,
        ),
        DetectorModel(
            offset_scale=0.97,
            noise_m=0.15,
            range_m=7.0,
            in_view_s=3.0,
            miss=0.005,
            ok_s=30.0,
            bad_s=6.0,
        ),
    ),
}

_OF_WORLD = {field.name for field in fields(World)}
_OF_DETECTOR = {field.name for field in fields(DetectorModel)}


def simulate(
    preset: str = "quickstart",
    seed: int = 0,
    frames: int | None = None,
    n_lanes: int | None = None,
    **overrides: float,
) -> SimulatedDrive:
    """Simulate a drive; the same arguments give the same drive.

    - preset: a name in `PRESETS`
    - frames, n_lanes: replace the preset's values
    - overrides: replace any fields of `World` or `DetectorModel`, by their names

    Raises InputError for an unknown preset or key, with a suggestion, and for a value that is out
    of range, naming the key.

    >>> import egolane_pgm as ego
    >>> drive = ego.simulate("a4", frames=30)
    >>> len(drive.log), drive.n_lanes, list(drive.truth)
    (30, 4, ['true_lane', 'is_crossing'])
    """
    check_names(_OF_WORLD | _OF_DETECTOR, overrides, "simulation")
    of_detector = {k: overrides.pop(k) for k in _OF_DETECTOR & overrides.keys()}
    road = simulated_road(preset, seed, frames, n_lanes, **overrides)
    detector = _changed(PRESETS[preset].detector, of_detector)
    is_failing = sensor_failures(detector, road, seed)
    log = detect_lines(road, is_failing, detector, seed)
    return SimulatedDrive(log, road.truth, road.n_lanes, road.position_m, is_failing)


def simulated_road(
    preset: str = "quickstart",
    seed: int = 0,
    frames: int | None = None,
    n_lanes: int | None = None,
    **overrides: float,
) -> Road:
    """Simulate the road and the drive along it, without lines of a detector; see `simulate`.

    overrides: replace any fields of `World`, by their names
    """
    if preset not in PRESETS:
        raise InputError(f"simulation: unknown preset '{preset}'{suggestion(preset, PRESETS)}")
    check_names(_OF_WORLD, overrides, "simulation")
    if seed < 0:
        raise InputError(f"simulation.seed: {seed} must not be negative")
    given = {"n_frames": frames, "n_lanes": n_lanes}
    changes = {**overrides, **{k: v for k, v in given.items() if v is not None}}
    return simulate_road(_changed(PRESETS[preset].world, changes), seed)


def _changed(settings: Any, changes: Mapping[str, Any]) -> Any:
    """Return a world or a detector with other values. Raises InputError, naming the key."""
    try:
        return replace(settings, **changes)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InputError(
            f"simulation.{first['loc'][0]}: {first['input']}: {first['msg'].lower()}"
        ) from None
