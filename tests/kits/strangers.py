"""Recordings as detectors with other habits might have written them.

The first part are pure functions of a `LineLog` (seeded where chance plays a part), the second
part says with which of them the ten recordings are tried: `STRANGERS`, by name, from a `Drive` to
one or several. How far lines of the multi-lane detector stray, for how long, and which of them it
sees was measured on run 5 (`results/beyond/failures.md`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtri

from egolane_pgm.evidence.line_geometry.lane_width import LaneWidth, gap_counts, width_of_gaps
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.loading import experiments_folder, load_experiment
from egolane_pgm.model import make_evidence
from egolane_pgm.runs import table_inputs
from egolane_pgm.simulation import simulate
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog

FRAME_RATE = 10.0


# Offsets ------------------------------------------------------------------------------------------


def scaled(log: LineLog, factor: float | FloatArray) -> LineLog:
    """Offsets in another unit; one factor, or one of each frame (T,)."""
    return replace(log, offset_m=log.offset_m * np.reshape(factor, (-1, 1)))


def shifted(log: LineLog, by_m: float | FloatArray) -> LineLog:
    """All lines moved to the right, by the same or in each frame by another amount (T,)."""
    return _moved(log, np.broadcast_to(np.reshape(by_m, (-1, 1)), log.offset_m.shape))


def noisy(log: LineLog, sigma_m: float, seed: int = 0) -> LineLog:
    """Each line moved by itself, anew in each frame."""
    return _moved(log, sigma_m * _rng(seed).standard_normal(log.offset_m.shape))


def jittered(log: LineLog, sigma_m: float, seed: int = 0) -> LineLog:
    """All lines of a frame moved together, anew in each frame."""
    return shifted(log, sigma_m * _rng(seed).standard_normal(len(log)))


def drifting_scale(log: LineLog, sd: float, seconds: float, seed: int = 0) -> LineLog:
    """The logarithm of the scale wanders: standard deviation, time constant."""
    return scaled(log, np.exp(sd * wandering(len(log), seconds * FRAME_RATE, seed)))


def drifting_shift(log: LineLog, sd_m: float, seconds: float, seed: int = 0) -> LineLog:
    """All lines wander together to the sides: standard deviation, time constant."""
    return shifted(log, sd_m * wandering(len(log), seconds * FRAME_RATE, seed))


def scale_changes(log: LineLog, factor: float) -> LineLog:
    """Offsets are in another unit from the middle of the recording on."""
    return scaled(log, np.where(np.arange(len(log)) < len(log) // 2, 1.0, factor))


def mirrored(log: LineLog) -> LineLog:
    """Left and right exchanged (so are the lanes)."""
    return scaled(log, -1.0)


def half_mirrored(log: LineLog, seed: int = 0) -> LineLog:
    """Each line of each frame is with probability .5 reported on the wrong side."""
    sign = np.where(_rng(seed).random(log.offset_m.shape) < 0.5, -1.0, 1.0)
    return replace(log, offset_m=log.offset_m * sign)


# Flags and LRI ------------------------------------------------------------------------------------


def lri_scaled(log: LineLog, factor: float) -> LineLog:
    """The LRI on another scale, e.g. 0 to 1."""
    return replace(log, lri=log.lri * factor)


def lri_always(log: LineLog, value: float) -> LineLog:
    """The same LRI on every line; NaN: unknown."""
    return replace(log, lri=np.where(_placed(log), value, np.nan))


def never_valid(log: LineLog) -> LineLog:
    """No line has the flag `valid`."""
    return replace(log, is_valid=np.zeros_like(log.is_valid))


def never_continuous(log: LineLog) -> LineLog:
    """No line has the flag `continuous`."""
    return replace(log, is_continuous=np.zeros_like(log.is_continuous))


def once_continuous(log: LineLog) -> LineLog:
    """One line in the whole recording has the flag `continuous`."""
    flags = np.zeros_like(log.is_continuous)
    flags[tuple(np.argwhere(log.is_valid)[len(log) // 3])] = True
    return replace(log, is_continuous=flags)


def always_continuous(log: LineLog) -> LineLog:
    """Every line has the flag `continuous`."""
    return replace(log, is_continuous=_placed(log))


def offsets_alone(log: LineLog) -> LineLog:
    """The offsets of the valid lines and nothing else."""
    kept = without(log, ~log.is_valid)
    return lri_always(never_continuous(kept), np.nan)


# Which lines there are ----------------------------------------------------------------------------


def without(log: LineLog, gone: BoolArray) -> LineLog:
    """Without some of the lines, (T, L)."""
    return replace(
        log,
        offset_m=np.where(gone, np.nan, log.offset_m),
        is_valid=log.is_valid & ~gone,
        is_continuous=log.is_continuous & ~gone,
        lri=np.where(gone, np.nan, log.lri),
    )


def with_lines(log: LineLog, offset_m: FloatArray) -> LineLog:
    """With more lines (T, K), valid, with the LRI of a well tracked line; NaN: none."""
    is_there = np.isfinite(offset_m)
    return replace(
        log,
        offset_m=np.concatenate([log.offset_m, offset_m], axis=1),
        is_valid=np.concatenate([log.is_valid, is_there], axis=1),
        is_continuous=np.concatenate([log.is_continuous, np.zeros_like(is_there)], axis=1),
        lri=np.concatenate([log.lri, np.where(is_there, 10.0, np.nan)], axis=1),
    )


def nearest(log: LineLog, count: int) -> LineLog:
    """Only the valid lines nearest to the vehicle."""
    away = np.where(log.is_valid, np.abs(log.offset_m), np.inf)
    return without(log, ~log.is_valid | (away.argsort(axis=1).argsort(axis=1) >= count))


def missing(log: LineLog, share: float, seed: int = 0) -> LineLog:
    """Lines missing at random."""
    return without(log, _rng(seed).random(log.offset_m.shape) < share)


def blind(log: LineLog, share: float, seconds: float, seed: int = 0) -> LineLog:
    """No line at all, for some seconds at a time."""
    gone = _spells(len(log), 1, share, seconds, seed)
    return without(log, np.broadcast_to(gone, log.offset_m.shape))


def cluttered(log: LineLog, count: int, seconds: float, seed: int = 0) -> LineLog:
    """False lines anywhere within two lanes, each of which keeps its offset for some seconds (but
    for 3 cm)."""
    rng, every = _rng(seed), round(seconds * FRAME_RATE)
    places = rng.uniform(-7.0, 7.0, (len(log) // every + 1, count)).repeat(every, axis=0)
    return with_lines(log, places[: len(log)] + 0.03 * rng.standard_normal((len(log), count)))


def twice(log: LineLog, apart_m: float = 0.0) -> LineLog:
    """Each valid line reported as two."""
    copies = np.where(log.is_valid, log.offset_m + apart_m, np.nan)
    return with_lines(log, copies)


def beside_road(
    log: LineLog, position: FloatArray, lines: Sequence[float], width_m: float
) -> LineLog:
    """With lines that are always seen.

    - position: (T,) the vehicle's place, lanes from the left edge of the road
    - lines: their places, likewise
    - width_m: of a lane
    """
    return with_lines(log, (np.asarray(lines) - position[:, None]) * width_m)


def held(log: LineLog, share: float, seconds: float, seed: int = 0) -> LineLog:
    """Lines that are for some seconds reported where they were, with a falling LRI."""
    keep = _spells(*log.offset_m.shape, share, seconds, seed) & _placed(log)
    keep[0] = False
    offset, lri = log.offset_m.copy(), log.lri.copy()
    for t in range(1, len(log)):
        stays = keep[t] & np.isfinite(offset[t - 1])
        offset[t, stays] = offset[t - 1, stays]
        lri[t, stays] = np.maximum(lri[t - 1, stays] - 1, 0)
    return replace(log, offset_m=offset, lri=lri)


def slipped(log: LineLog, width_m: float, share: float, seconds: float, seed: int = 0) -> LineLog:
    """Slots that for some seconds report the line next to theirs: moved by a lane."""
    spells = _spells(*log.offset_m.shape, share, seconds, seed)
    side = np.where(_spells(*log.offset_m.shape, 0.5, 10 * seconds, seed + 1), 1.0, -1.0)
    return _moved(log, np.where(spells, side * width_m, 0.0))


def few_middle_lines(
    log: LineLog,
    position: FloatArray,
    n_lanes: int,
    width_m: float,
    share: float,
    seconds: float,
    seed: int = 0,
) -> LineLog:
    """Lines between the lanes that are missing for some seconds at a time, each by itself; those at
    the edges of the road stay."""
    gone = _spells(len(log), n_lanes + 1, share, seconds, seed)
    gone[:, [0, n_lanes]] = False
    with np.errstate(invalid="ignore"):
        line = np.round(log.offset_m / width_m + position[:, None])
    line = np.where((line >= 0) & (line <= n_lanes), line, 0).astype(np.int64)
    return without(log, np.take_along_axis(gone, line, axis=1))


def seen_at_times(
    log: LineLog,
    offset_m: FloatArray,
    share: FloatArray,
    seconds: float,
    seed: int = 0,
) -> LineLog:
    """With one more line (T,) that is seen for some seconds at a time, a share (T,) of the time."""
    height = wandering(len(log), seconds * FRAME_RATE, seed)
    # `share` is that of a standard normal below the threshold.
    is_seen = height < ndtri(np.clip(share, 0.0, 1.0))
    return with_lines(log, np.where(is_seen, offset_m, np.nan)[:, None])


# Frames -------------------------------------------------------------------------------------------


def replayed(log: LineLog, source: IntArray, frame_rate: float = FRAME_RATE) -> LineLog:
    """Frames `source` (indices, not necessarily increasing) as a recording of their own."""
    frame_id = np.arange(len(source))
    return LineLog(
        frame_id,
        frame_id / frame_rate,
        log.offset_m[source],
        log.is_valid[source],
        log.is_continuous[source],
        log.lri[source],
        log.is_missing[source],
        log.source,
    )


def clock_jumps(log: LineLog, by_s: float) -> LineLog:
    """A clock that jumps in the middle of the recording; frame ids go on."""
    return replace(
        log, time_s=log.time_s + np.where(np.arange(len(log)) < len(log) // 2, 0.0, by_s)
    )


# Chance -------------------------------------------------------------------------------------------


def wandering(n_frames: int, time_constant: float, seed: int) -> FloatArray:
    """(T,) an autoregressive process of order one with standard deviation 1 in every frame.
    time_constant: frames."""
    keep = float(np.exp(-1 / time_constant))
    steps = _rng(seed).standard_normal(n_frames)
    steps[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], steps))


def _spells(n_frames: int, n: int, share: float, seconds: float, seed: int) -> BoolArray:
    """(T, n) spells that last for so many seconds on average and fill that share of the time."""
    rng = _rng(seed)
    ends = 1 / max(1.0, seconds * FRAME_RATE)
    begins = min(1.0, ends * share / (1 - share))
    chance = rng.random((n_frames, n))
    inside = np.empty((n_frames, n), dtype=bool)
    now = rng.random(n) < share
    for t in range(n_frames):
        now = np.where(now, chance[t] >= ends, chance[t] < begins)
        inside[t] = now
    return inside


def _restarts(position: FloatArray, share: float, n_frames: int, seed: int) -> BoolArray:
    """(T,) the frames from two before a line is crossed on, in a share of the crossings."""
    crossings = np.flatnonzero(np.diff(np.floor(position)))
    chosen = crossings[_rng(seed).random(len(crossings)) < share]
    frames = np.zeros(len(position), dtype=bool)
    for first in np.maximum(chosen - 2, 1):
        frames[first : first + n_frames] = True
    return frames


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def _placed(log: LineLog) -> BoolArray:
    return np.isfinite(log.offset_m) & (log.offset_m != 0)


def _moved(log: LineLog, by_m: FloatArray) -> LineLog:
    # An offset of exactly 0 is a placeholder.
    return replace(log, offset_m=np.where(_placed(log), log.offset_m + by_m, log.offset_m))


# Drives -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """A recording with what is known of it.

    - log: T frames
    - lane: (T,) true lane, 1 (leftmost) to n; 0 where it is not scored
    - position: (T,) place of the vehicle, lanes from the left edge of the road
    - width_m: of a lane, in the unit of the log
    - run: the paper's; a number that chance depends on
    """

    run: int
    log: LineLog
    lane: IntArray
    position: FloatArray
    n_lanes: int
    width_m: float

    def take(self, source: IntArray, frame_rate: float = FRAME_RATE) -> Drive:
        """As `replayed`."""
        log = replayed(self.log, source, frame_rate)
        return replace(self, log=log, lane=self.lane[source], position=self.position[source])

    def kept(self, frames: BoolArray | IntArray) -> Drive:
        """Some of the frames, with the ids that they have."""
        log = self.log.take(frames)
        return replace(self, log=log, lane=self.lane[frames], position=self.position[frames])


def lane_width(log: LineLog, fallback_m: float) -> LaneWidth:
    """The lane width of a whole recording. fallback_m: the expected width."""
    return width_of_gaps(gap_counts(log), fallback_m, log.source)


@functools.cache
def paper_drive(run: int) -> Drive:
    """One of the paper's ten runs; needs EGOLANE_DATA.

    The position is that of the smoother that is told the labels.
    """
    table = experiments_folder() / "paper" / "recordings.csv"
    base = load_experiment("zero_label", {"parameters.lane_width_m": "auto"})
    given = table_inputs(base, table)[run - 1]
    [drive] = given.drives()
    log, model, n_lanes = drive.log, drive.model, drive.model.n_lanes
    label = np.where(drive.is_crossing, 0, drive.true_lane)
    lane = label.copy()
    lane[drive.rows[~drive.is_trusted]] = 0
    evidence = make_evidence(model, log)[0]
    ((key, likelihood),) = evidence.likelihoods.items()
    n_places = likelihood.shape[1]
    lane_of_place = np.arange(n_places) * n_lanes // n_places + 1
    may_be = (label[:, None] == 0) | (label[:, None] == lane_of_place)
    told = Evidence({key: likelihood * np.where(may_be, 1.0, 1e-6)[..., None]}, evidence.inputs)
    places = smooth_beliefs(model.compiled, told).marginals["RoadPosition"]
    position = places @ ((np.arange(n_places) + 0.5) * n_lanes / n_places)
    width_m = lane_width(log, 3.5).width_m
    return Drive(run, log, lane, position, n_lanes, width_m)


def simulated_drive(preset: str, seed: int, n_frames: int) -> Drive:
    """A drive that does not exist."""
    drive = simulate(preset, seed=seed, frames=n_frames)
    lane = np.where(drive.truth["is_crossing"], 0, drive.truth["true_lane"])
    width_m = lane_width(drive.log, 3.5).width_m
    return Drive(seed, drive.log, lane, drive.position_m / width_m, drive.n_lanes, width_m)


Change = Callable[[Drive], Sequence[Drive]]


def _lines(change: Callable[..., LineLog], *words: Any, **named: Any) -> Change:
    """A change of the lines only."""
    return lambda drive: [replace(drive, log=change(drive.log, *words, **named))]


def _of_drive(change: Callable[[Drive], LineLog]) -> Change:
    """A change of the lines for which the vehicle's true place counts."""
    return lambda drive: [replace(drive, log=change(drive))]


def _frames(source: Callable[[Drive], IntArray], frame_rate: float = FRAME_RATE) -> Change:
    return lambda drive: [drive.take(source(drive), frame_rate)]


def _every(step: int) -> Callable[[Drive], IntArray]:
    return lambda drive: np.arange(0, len(drive.log), step)


def _every_id(step: int) -> Change:
    return lambda drive: [drive.kept(_every(step)(drive))]


def _mirrored(drive: Drive) -> list[Drive]:
    lane = np.where(drive.lane > 0, drive.n_lanes + 1 - drive.lane, 0)
    position = drive.n_lanes - drive.position
    return [replace(drive, log=mirrored(drive.log), lane=lane, position=position)]


def _pieces(n_frames: int) -> Change:
    """Ten short recordings."""
    return lambda drive: [
        drive.take(np.arange(first, first + n_frames))
        for first in np.linspace(0, len(drive.log) - n_frames, 10).astype(np.int64)
    ]


def _beside(left: Sequence[float], right: Sequence[float]) -> Change:
    """Lines always seen so many lanes left and right of the road."""

    def change(drive: Drive) -> LineLog:
        lines = [-away for away in left] + [drive.n_lanes + away for away in right]
        return beside_road(drive.log, drive.position, lines, drive.width_m)

    return _of_drive(change)


def _quicker(drive: Drive) -> list[Drive]:
    """Thirty frames a second: each frame three times, with 1 cm of noise."""
    fast = drive.take(np.arange(len(drive.log)).repeat(3), 3 * FRAME_RATE)
    return [replace(fast, log=noisy(fast.log, 0.01))]


def _stands(drive: Drive) -> list[Drive]:
    """Ten minutes in front of the same lines, in the middle of the recording."""
    middle = int(np.flatnonzero(drive.lane > 0)[np.count_nonzero(drive.lane > 0) // 2])
    source = np.concatenate(
        [np.arange(middle), np.full(6000, middle), np.arange(middle, len(drive.log))]
    )
    still = drive.take(source)
    by = np.where(np.arange(len(source)) // 6000 == middle // 6000, 0.02, 0.0)
    offset = still.log.offset_m + by[:, None] * _rng(0).standard_normal(still.log.offset_m.shape)
    return [replace(still, log=replace(still.log, offset_m=offset))]


def in_lane_change(drive: Drive) -> int:
    """A frame in the middle of a lane change, near the middle of the recording."""
    labelled = np.flatnonzero(drive.lane > 0)
    before, after = labelled[:-1], labelled[1:]
    is_change = (drive.lane[before] != drive.lane[after]) & (after - before > 1)
    middles = (before[is_change] + after[is_change]) // 2
    return int(middles[len(middles) // 2])


def _begins_in_change(drive: Drive) -> list[Drive]:
    return [drive.take(np.arange(in_lane_change(drive), len(drive.log)))]


def like_multi_lane(drive: Drive, scale: float = 0.05, seconds: float = 1.5) -> Drive:
    """Lines as the multi-lane detector has them on run 5, from where the vehicle is; the drive's
    own lines are not used.

    - Lanes are about half as wide as they are; the scale strays (`scale`, `seconds`: how far in
      logarithms, and how long), and by 2 % from frame to frame.
    - Lines are where they will be in half a second; all of them stray together by .06 lanes for two
      seconds, each by .04 lanes in each frame.
    - The edges of the road are seen from up to two lanes away for 75 % of the time, the lines
      between lanes for half of it, most often for seconds and now and then for half a minute.
    - The line of the emergency lane and a barrier left of the road are seen, too.
    - Slots slip by a lane in 4 % of the time, a tenth of the lines are held. There are no flags.
    - The tracker starts anew in every tenth lane change, and reports nothing for .7 s.
    """
    n, position, seed = drive.n_lanes, drive.position, 100 * drive.run
    log = without(drive.log, np.ones_like(drive.log.is_valid))
    ahead = np.concatenate([position[5:], np.full(5, position[-1])])
    right, left = n - position, position
    seen = [np.full(len(log), 0.5)] * (n + 1)
    seen[0], seen[n] = (np.clip(0.8 - 0.4 * (away - 2), 0.1, 0.8) for away in (left, right))
    seen = [np.where(np.abs(k - position) < 2.7, share, 0.1) for k, share in enumerate(seen)]
    seen += [0.9 * np.exp(-left / 0.7), np.minimum(0.65, 1.1 * np.exp(-right / 1.2))]
    for k, (place, share) in enumerate(zip([*range(n + 1), -1.35, n + 1], seen, strict=True)):
        log = seen_at_times(log, place - ahead, share, 6.0, seed + k)
    log = slipped(log, 1.0, 0.04, 1.0, seed + 20)
    log = noisy(log, 0.04, seed + 21)
    log = drifting_shift(log, 0.06, 2.0, seed + 22)
    log = drifting_scale(log, scale, seconds, seed + 23)
    log = scaled(log, np.exp(0.02 * _rng(seed + 24).standard_normal(len(log))))
    log = held(log, 0.1, 0.3, seed + 25)
    width_m = 0.52 * drive.width_m
    made = replace(drive, log=scaled(log, width_m), width_m=width_m)
    return made.kept(~_restarts(position, 0.1, 7, seed + 26))


#: Detectors that nobody has seen, by name.
STRANGERS: Mapping[str, Change] = {
    "as recorded": lambda drive: [drive],
    "offsets x 0.5": _lines(scaled, 0.5),
    "offsets x 0.65": _lines(scaled, 0.65),
    "offsets x 1.5": _lines(scaled, 1.5),
    "offsets x 2": _lines(scaled, 2.0),
    "offsets in feet": _lines(scaled, 1 / 0.3048),
    "offsets in centimetres": _lines(scaled, 100.0),
    "LRI 0 to 1": _lines(lri_scaled, 0.1),
    "LRI always 0": _lines(lri_always, 0.0),
    "LRI unknown": _lines(lri_always, np.nan),
    "no line valid": _lines(never_valid),
    "no line valid, LRI unknown": _lines(lambda log: lri_always(never_valid(log), np.nan)),
    "no line continuous": _lines(never_continuous),
    "one line continuous": _lines(once_continuous),
    "all lines continuous": _lines(always_continuous),
    "offsets alone, of valid lines": _lines(offsets_alone),
    "nearest 2 lines": _lines(nearest, 2),
    "30 % of lines missing": _lines(missing, 0.3),
    "60 % of lines missing": _lines(missing, 0.6),
    "every 5th frame, ids jump": _every_id(5),
    "every 10th frame, ids jump": _every_id(10),
    "every 5th, renumbered, rate said": _frames(_every(5), 2.0),
    "every 5th, renumbered, rate not said": _frames(_every(5)),
    "every 10th, renumbered, rate said": _frames(_every(10), 1.0),
    "30 frames a second": _quicker,
    "a line of clutter, for 2 s each": _lines(cluttered, 1, 2.0),
    "two, for 10 s each": _lines(cluttered, 2, 10.0),
    "noise of .3 m": _lines(noisy, 0.3),
    "all lines together off by .3 m": _lines(jittered, 0.3),
    "camera .6 m off": _lines(shifted, 0.6),
    "camera 1 m off": _lines(shifted, 1.0),
    "each line twice": _lines(twice),
    "double lines, 20 cm apart": _lines(twice, 0.2),
    "a line .5 lanes right of the road": _beside([], [0.5]),
    "a line .9 lanes right of the road": _beside([], [0.9]),
    "lines .4 lanes beside the road": _beside([0.4], [0.4]),
    "blind for 2 s, 30 % of the time": _lines(blind, 0.3, 2.0),
    "mirrored": _mirrored,
    "50 frames, ten places": _pieces(50),
    "200 frames, ten places": _pieces(200),
    "500 frames, ten places": _pieces(500),
    "scale strays by 5 % for 2 s": _lines(drifting_scale, 0.05, 2.0),
    "scale strays by 15 % for 60 s": _lines(drifting_scale, 0.15, 60.0),
    "all lines stray by .1 lanes for 2 s": _of_drive(
        lambda drive: drifting_shift(drive.log, 0.1 * drive.width_m, 2.0)
    ),
    "slots slip by a lane for 3 s, 10 % of the time": _of_drive(
        lambda drive: slipped(drive.log, drive.width_m, 0.1, 3.0)
    ),
    "half of the middle lines missing, for 5 s each": _of_drive(
        lambda drive: few_middle_lines(
            drive.log, drive.position, drive.n_lanes, drive.width_m, 0.5, 5.0
        )
    ),
    "lines held for 1 s, 20 % of the time": _lines(held, 0.2, 1.0),
    "like run 5": lambda drive: [like_multi_lane(drive)],
    "like run 5, scale off by 15 % for 20 s": lambda drive: [like_multi_lane(drive, 0.15, 20.0)],
    "scale x 0.6 from the middle on": _lines(scale_changes, 0.6),
    "half of the lines mirrored": _lines(half_mirrored),
    "the nearest line only": _lines(nearest, 1),
    "stands still for ten minutes": _stands,
    "begins in a lane change": _begins_in_change,
    "clock jumps by an hour": _lines(clock_jumps, 3600.0),
    "clock jumps back by an hour": _lines(clock_jumps, -3600.0),
}
