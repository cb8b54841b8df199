"""The road and the vehicle on it: the exact position of the lane lines in every frame.

The simulated detector and the drawn pictures both use it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, lane_truth

if TYPE_CHECKING:
    import pandas as pd

#: The largest wander inside the lane, standard deviations.
_WANDER_LIMIT = 2.5

#: The correlation time of the wander, seconds.
_WANDER_S = 5.0

#: The shortest lane change, as a multiple of the median duration.
_SHORTEST = 0.6

#: The longest lane change, as a multiple of the median duration.
_LONGEST = 1.7

#: Kinds of settings. A million is a slip of the finger in any unit.
Positive = Annotated[float, Field(gt=0, le=1e6)]
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Share = Annotated[float, Field(ge=0, le=1)]


@checked_dataclass(frozen=True)
class World:
    """A straight motorway, a vehicle that changes lane on it, and how a person annotates the drive.

    - n_lanes: number of lanes; lane 1 is the leftmost
    - lane_width_m: distance between neighbouring lines
    - n_frames: length of the drive
    - frame_rate: frames per second
    - changes_per_minute: rate of lane changes; their number is rounded down
    - change_s: median duration of a lane change, from leaving one lane's centre to reaching the
      next, seconds
    - change_spread: standard deviation of the logarithm of that duration, which stays within 0.6
      and 1.7 times the median
    - min_stay_s: shortest stay in a lane between two changes, seconds
    - wander_m: standard deviation of the position about the lane's centre; at most 2.5 times as
      much occurs
    - crossing_share: share of a lane change, in its middle, that is annotated as crossing
    - label_flips_at: where in the crossing the annotated lane changes: 1 is its end (as in the
      Italian recordings); the Spanish ones have 0.65
    - shoulder_m: distance from the rightmost lane line to one more line on its right (the end of
      the hard shoulder, a guard rail); 0 for none

    A lane change should last some frames, and crossing_share should be so large that the wandering
    vehicle is across a line inside the annotated crossing only.
    """

    n_lanes: Annotated[int, Field(ge=1, le=100)] = 3
    lane_width_m: Positive = 3.75
    n_frames: Annotated[int, Field(ge=1, le=10_000_000)] = 1200
    frame_rate: Positive = 10.0
    changes_per_minute: NotNegative = 5.0
    change_s: Positive = 4.0
    change_spread: NotNegative = 0.2
    min_stay_s: NotNegative = 1.0
    wander_m: NotNegative = 0.2
    crossing_share: Share = 0.5
    label_flips_at: Share = 1.0
    shoulder_m: NotNegative = 0.0


@dataclass(frozen=True)
class Road:
    """A drive over T frames without noise or detector.

    - frame_rate: frames per second
    - position_m: (T,) distance of the vehicle from the leftmost line, positive to the right
    - lane, is_crossing: (T,) as annotated
    - line_offset_m: (T, n + 1) lane lines as seen from the vehicle, leftmost first, metres,
      negative on the left; NaN where lanes have not begun yet or have ended
    - shoulder_offset_m: (T,) the additional line on the right; NaN if there is none
    """

    frame_rate: float
    n_lanes: int
    position_m: FloatArray
    lane: IntArray
    is_crossing: BoolArray
    line_offset_m: FloatArray
    shoulder_offset_m: FloatArray

    def __len__(self) -> int:
        return len(self.position_m)

    @property
    def truth(self) -> pd.DataFrame:
        """The ground truth; frame ids count from 0."""
        return lane_truth(np.arange(len(self.lane)), self.lane, self.is_crossing, "simulated road")


def slow_noise(
    rng: np.random.Generator, n_frames: int, n_series: int, correlation_frames: float
) -> FloatArray:
    """Stationary first-order autoregressive noise, (T, K), with mean 0 and standard deviation 1.

    correlation_frames: frames over which the correlation falls to 1/e; 0 gives white noise.
    """
    keep = float(np.exp(-1.0 / correlation_frames)) if correlation_frames > 0 else 0.0
    noise = rng.standard_normal((n_frames, n_series))
    noise[1:] *= np.sqrt(1.0 - keep * keep)
    for t in range(1, n_frames):
        noise[t] += keep * noise[t - 1]
    return noise


def simulate_road(world: World, seed: int) -> Road:
    """Simulate a drive along `world`; the same seed gives the same drive.

    Raises InputError if the lane changes do not fit into the frames.
    """
    rng = np.random.default_rng([seed, 0])
    n = world.n_lanes
    width = world.lane_width_m
    minutes = world.n_frames / world.frame_rate / 60.0
    count = int(world.changes_per_minute * minutes + 1e-9) if n > 1 else 0
    stretch = np.exp(world.change_spread * rng.standard_normal(count))
    seconds = world.change_s * np.clip(stretch, _SHORTEST, _LONGEST)
    length = np.maximum(np.round(seconds * world.frame_rate), 1).astype(np.int64)
    stay = int(np.ceil(world.min_stay_s * world.frame_rate))
    free = world.n_frames - int(length.sum()) - (count + 1) * stay
    if count and free < 0:
        raise InputError(
            f"simulation.changes_per_minute: {count} lane changes do not fit into"
            f" {world.n_frames} frames; reduce it, change_s or min_stay_s"
        )
    # All ways to distribute the free frames are equally likely, as for changes at a constant rate.
    cuts = np.sort(rng.integers(0, max(free, 0) + 1, size=count))
    first = np.cumsum(np.diff(cuts, prepend=0) + stay) + np.cumsum(length) - length

    centre = np.zeros(world.n_frames)
    lane = np.zeros(world.n_frames, dtype=np.int64)
    is_crossing = np.zeros(world.n_frames, dtype=bool)
    now = int(rng.integers(1, n + 1))
    centre += now
    lane += now
    for start, frames, coin in zip(first, length, rng.random(len(first)), strict=True):
        step = 1 if now == 1 else -1 if now == n else (1 if coin < 0.5 else -1)
        phase = (np.arange(frames) + 0.5) / frames
        # Minimum jerk: no speed and no acceleration at both ends.
        centre[start : start + frames] += step * (phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))
        centre[start + frames :] += step
        crossing = max(1, round(world.crossing_share * int(frames)))
        enters = start + (frames - crossing) // 2
        is_crossing[enters : enters + crossing] = True
        lane[enters + round(world.label_flips_at * crossing) :] += step
        now += step

    wander = slow_noise(rng, world.n_frames, 1, _WANDER_S * world.frame_rate)[:, 0]
    wander = _WANDER_LIMIT * np.tanh(wander / _WANDER_LIMIT)
    position_m = (centre - 0.5) * width + world.wander_m * wander
    lines = np.arange(n + 1) * width - position_m[:, None]
    shoulder = n * width + world.shoulder_m - position_m
    return Road(
        world.frame_rate,
        n,
        position_m,
        lane,
        is_crossing,
        lines,
        shoulder if world.shoulder_m > 0 else np.full(world.n_frames, np.nan),
    )
