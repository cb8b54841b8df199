"""Drives composed of a donor's frames, for the path of another car.

Each reported line of a donor has a place on its road: the number of a line of the road and the
distance from it, a distance from the edge of the road, or, for clutter, from the car. A new drive
takes segments of 10 to 60 s from the same kind of lane (leftmost, inner, rightmost), and lane
changes of the donor. Lines that the new road lacks are dropped; if a line's role changes (edge or
not), its continuous flag is drawn again.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd

from egolane_pgm.evidence.line_geometry.flag_semantics import is_placed
from egolane_pgm.inference.kernels.sweeps import best_path
from egolane_pgm.scoring.events import lane_changes
from egolane_pgm.types import FloatArray, IntArray, LineLog, lane_truth, runs_of

#: Frames per second of every drive.
RATE = 10.0

#: Frames of a stretch, at least and at most, and of a lane change before and after its middle.
_STRETCH, _CHANGE = (100, 600), 30

#: Largest distance of a report from a line of the road, and of a car's move in a frame, lanes;
#: largest distance of a reported line, metres.
_NEAR, _JUMP, _REACH_M = 0.25, 0.3, 16.5

#: Positions across a lane, how much a car moves from frame to frame (lanes), and the standard
#: deviation of a line about its place (lanes).
_PLACES, _MOVES, _SPREAD = 32, 0.02, 0.06


@dataclass(frozen=True)
class Path:
    """The path of a car on a road of n lanes: `across` (T,) is its place, lanes from the left edge
    (lane k is k - 1 to k)."""

    across: FloatArray
    n_lanes: int

    def lane(self) -> IntArray:
        """(T,): 1 to n."""
        return np.clip(np.floor(self.across).astype(np.int64) + 1, 1, self.n_lanes)

    def truth(self) -> pd.DataFrame:
        """Its lanes; crossing for 10 frames before and after the car's middle is on a line."""
        lane = self.lane()
        is_crossing = np.zeros(len(lane), dtype=bool)
        for k in np.flatnonzero(np.diff(lane)):
            is_crossing[max(0, k - 9) : k + 11] = True
        return lane_truth(np.arange(len(lane)), lane, is_crossing)


@dataclass(frozen=True)
class Donor:
    """A real log, T frames of at most L lines, and the path of its car.

    - width_m: of a lane, in the detector's metres.
    - number (T, L): of a line of the road, 0 (left edge) to n; -1: off the road, or clutter.
    - place (T, L): distance in lanes from that line; off the road, from the left edge (negative)
      or the right one (positive); NaN for clutter.
    - change_at (C,): the frames in which the car's middle crosses a line.
    - continuous (3,): how often a valid line at the left edge, inside, at the right edge is
      reported as continuous.
    """

    log: LineLog
    path: Path
    width_m: float
    number: IntArray
    place: FloatArray
    change_at: IntArray
    continuous: FloatArray


def donor_of(log: LineLog, truth: pd.DataFrame, n_lanes: int, width_m: float) -> Donor:
    """A donor from a log and the lanes of its frames, all of them annotated."""
    path = Path(_across(log, truth, width_m), n_lanes)
    where = path.across[:, None] + log.offset_m / width_m
    nearest = np.round(where)
    is_line = is_placed(log.offset_m)
    on_road = is_line & (np.abs(where - nearest) < _NEAR) & (nearest >= 0) & (nearest <= n_lanes)
    left, right = is_line & ~on_road & (where < 0), is_line & ~on_road & (where > n_lanes)
    number = np.where(on_road, nearest, -1).astype(np.int64)
    place = np.select([on_road, left, right], [where - nearest, where, where - n_lanes], np.nan)
    role = _side(number, 0, n_lanes)
    flags = [log.is_continuous[on_road & log.is_valid & (role == k)] for k in range(3)]
    continuous = np.array([each.mean() if each.size else 0.0 for each in flags])
    change_at = np.flatnonzero(np.diff(path.lane()) != 0) + 1
    return Donor(log, path, width_m, number, place, change_at, continuous)


def _across(log: LineLog, truth: pd.DataFrame, width_m: float) -> FloatArray:
    """(T,): the car's place across the road: inside the lane the best path on a circle given the
    lines (Viterbi), in the annotated lane between two changes."""
    centre = (np.arange(_PLACES) + 0.5) / _PLACES
    use = log.is_valid & is_placed(log.offset_m)
    off = np.where(use, log.offset_m, 0.0)[:, :, None] / width_m + centre
    off -= np.round(off)
    each = np.log(0.1 + np.exp(-0.5 * (off / _SPREAD) ** 2))
    score = (each * use[:, :, None]).sum(axis=1)
    apart = np.abs(centre[:, None] - centre)
    move = -0.5 * (np.minimum(apart, 1 - apart) / _MOVES) ** 2
    index, places = np.zeros((2, len(score)), dtype=np.int64)
    best_path(np.zeros((1, _PLACES)), move[None], score, index, places)
    steady = np.unwrap(centre[places], period=1.0)
    true_lane, crossing = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
    # Each stretch between two changes of the label gets the whole number that puts it in its lane;
    # a crossing goes with the stretch before it as far as the circle does.
    changes = lane_changes(truth)
    across = np.empty(len(steady))
    for start, stop in itertools.pairwise([0, *changes.end.tolist(), len(steady)]):
        kept = np.flatnonzero(~crossing[start:stop]) + start
        lift = np.round(np.median(true_lane[kept] - 0.5 - steady[kept])) if len(kept) else 0.0
        across[start:stop] = steady[start:stop] + lift
    for start, end in zip(changes.start.tolist(), changes.end.tolist(), strict=True):
        # If the lines were lost in a change, the circle may have gone the wrong way round.
        if np.abs(np.diff(across[max(start - 1, 0) : end + 1])).max(initial=0.0) > _JUMP:
            across[start:end] = np.linspace(across[max(start - 1, 0)], across[end], end - start)
    return np.clip(across, 0.0, true_lane.max() - 1e-6)


def transplanted(donor: Donor, path: Path, rng: np.random.Generator) -> LineLog:
    """The lines that the donor's detector would have seen of a car on a path, T frames."""
    frames, shift = _chosen(donor, path, rng)
    log, width, n_lanes = donor.log, donor.width_m, path.n_lanes
    number, place, across = donor.number[frames], donor.place[frames], path.across[:, None]
    on_road = number >= 0
    now = number + shift[:, None]
    from_line = np.where(on_road, now, np.where(place < 0, 0, n_lanes))
    # Clutter has no place and stays at its offset.
    offset = (from_line + place - across) * width
    offset = np.where(np.isnan(place), log.offset_m[frames], offset)
    is_gone = on_road & ((now < 0) | (now > n_lanes))
    is_gone |= ~np.isnan(place) & (np.abs(offset) > _REACH_M)
    is_valid = log.is_valid[frames] & ~is_gone
    role = _side(now, 0, n_lanes)
    changed = on_road & is_valid & (_side(number, 0, donor.path.n_lanes) != role)
    anew = rng.random(number.shape) < donor.continuous[role]
    continuous = np.where(changed, anew, log.is_continuous[frames]) & ~is_gone
    offset, lri = (np.where(is_gone, np.nan, each) for each in (offset, log.lri[frames]))
    frame = np.arange(len(frames))
    return LineLog(frame, frame / RATE, offset, is_valid, continuous, lri, source="transplanted")


def _side(value: IntArray, first: int, last: int) -> IntArray:
    """0 for the first value (left edge or leftmost lane), 2 for the last one, else 1."""
    return np.select([value == first, value == last], [0, 2], 1)


def _chosen(donor: Donor, path: Path, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """The donor's frame for each frame of a path, (T,), and by how many lines its road is moved.

    Segments are drawn first; lane changes replace parts of them.
    """
    lane, donor_lane = path.lane(), donor.path.lane()
    n_frames = len(lane)
    kinds, donor_kinds = _side(lane, 1, path.n_lanes), _side(donor_lane, 1, donor.path.n_lanes)
    frames, shift = np.zeros((2, n_frames), np.int64)
    changes = (np.flatnonzero(np.diff(lane)) + 1).tolist()
    for start, stop in itertools.pairwise([0, *changes, n_frames]):
        # A road without such a lane gives its nearest, the inner one.
        alike = runs_of(donor_kinds == kinds[start]) or runs_of(donor_kinds == 1)
        alike = [run for run in alike if run[1] - run[0] >= _STRETCH[0]] or alike
        lengths = np.diff(alike).ravel()
        while start < stop:
            first, last = alike[rng.choice(len(alike), p=lengths / lengths.sum())]
            length = min(int(rng.integers(*_STRETCH)), stop - start, last - first)
            begin = int(rng.integers(first, last - length + 1))
            frames[start : start + length] = np.arange(begin, begin + length)
            shift[start : start + length] = lane[start] - donor_lane[begin]
            start += length
    at_change = donor.change_at
    for at in changes:
        step = np.sign(lane[at] - lane[at - 1])
        alike_at = at_change[np.sign(donor_lane[at_change] - donor_lane[at_change - 1]) == step]
        same = alike_at[
            (donor_kinds[alike_at - 1] == kinds[at - 1]) & (donor_kinds[alike_at] == kinds[at])
        ]
        if not len(alike_at):
            continue
        chosen = int(rng.choice(same if len(same) else alike_at))
        reach = np.arange(-_CHANGE, _CHANGE)
        reach = reach[(at + reach >= 0) & (at + reach < n_frames)]
        reach = reach[(chosen + reach >= 0) & (chosen + reach < len(donor_lane))]
        frames[at + reach] = chosen + reach
        shift[at + reach] = lane[at - 1] - donor_lane[chosen - 1]
    return frames, shift
