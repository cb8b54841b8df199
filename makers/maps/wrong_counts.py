"""A map that is wrong by a lane: how often it is found, how often that can be seen, and what it
helps where the map says that its number is a guess.

Guesses are all stretches on which the map is wrong, and three times as much of the road on which it
is right, in pieces of 30 s: right in three quarters, as guesses are on real maps.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from egolane_pgm.experiment import load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.maps import road_table
from egolane_pgm.maps.interchange import DETECTOR, Journey
from egolane_pgm.model import make_evidence
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.road import BEHIND_S
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from makers.maps._experiments import COUNTING, POSITIONS, prepared, simulated

N_DRIVES = 50

#: A stretch on which the map is wrong lasts so long at least, seconds. Shorter ones are changes
#: that are not where the map has them.
_LEAST_S = 10.0

#: The right number of lanes can be seen where a line that shows it was in view so long, seconds.
_SEEN_S = 1.0

#: How much of the guessed road is guessed right, for each wrong part; and the length of a piece.
_RIGHT_PARTS, _PIECE_S = 3, 30.0

#: What is believed: how probable a wrong number is on the whole map, and where it is a guess.
_GUESSED = {"road": "guessed.parquet"}
_CERTAIN = {"parameters.guess_wrong": 0.0}
_DOUBTS = {
    "map_wrong 0.1": {**COUNTING, "parameters.map_wrong": 0.1},
    "map_wrong 0": {**COUNTING, "parameters.map_wrong": 0.0},
    "guess_wrong 0.25": {**COUNTING, **_GUESSED},
    "guess_wrong 0": {**COUNTING, **_GUESSED, **_CERTAIN},
    "position, guess_wrong 0.25": {**POSITIONS, **_GUESSED},
    "position, guess_wrong 0": {**POSITIONS, **_GUESSED, **_CERTAIN},
}

#: A belief of so much is sure.
_SURE = 0.95


def measure() -> Iterator[str]:
    """Lines of text."""
    found, is_visible, beyond = [], [], []
    right: dict[tuple[str, str], list[FloatArray]] = defaultdict(list)
    for seed in range(N_DRIVES):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            experiment = simulated(folder, seed, None, False, wrong_per_km=0.2)
            _, real, on_map = np.loadtxt(
                folder / "lanes_truth.csv", delimiter=",", skiprows=1, dtype=np.int64
            ).T
            rate = experiment.recording.frame_rate
            stretches = _stretches(real - on_map, round(_LEAST_S * rate))
            is_guess = _mark_guesses(folder, stretches, len(real), rate, seed)
            for doubt, keys in _DOUBTS.items():
                model, recorded, road = prepared(load_experiment(experiment, keys))
                evidence = make_evidence(model, recorded.log, "soft", road).filtered
                beliefs = filter_beliefs(model.compiled, evidence, "exact")
                assert recorded.truth is not None
                lane = recorded.truth.lane
                is_right = assigned_lane(beliefs.lane) == lane
                scored = ~recorded.truth.is_crossing
                is_sure = beliefs.lane.max(axis=1) >= _SURE
                inside = np.zeros(len(real), dtype=bool)
                for a, b in stretches:
                    inside[a:b] = True
                places = {"there": inside, "where a guess is right": is_guess & ~inside}
                for where, among in {**places, "elsewhere": ~inside & ~is_guess}.items():
                    frames = scored & among
                    sure = frames & is_sure
                    told = (is_right & frames, frames, is_right & sure, sure)
                    right[doubt, where].append(np.array([each.sum() for each in told]))
                if doubt != "map_wrong 0.1":
                    continue
                believed = beliefs.marginals["Lanes"].argmax(axis=1) + 1
                for a, b in stretches:
                    first = slice(a, min(b, a + round(BEHIND_S * rate)))
                    found.append(bool((believed[first] == real[first]).any()))
                    # A line is in the detector's view up to its range, from the middle of the lane.
                    reach = DETECTOR.range_m / Journey().lane_width_m - 0.5
                    more, fewer = np.maximum(real, on_map)[first], np.minimum(real, on_map)[first]
                    beyond.append(int((more - lane[first] <= reach).sum()))
                    is_visible.append(int((fewer - lane[first] <= reach).sum()))
    least = _SEEN_S * rate
    share = [np.array(x) for x in (found, np.array(beyond) >= least, np.array(is_visible) >= least)]
    yield f"{len(found)} stretches on {N_DRIVES} drives"
    yield f"found within {BEHIND_S:g} s: {share[0].mean():.2f}"
    yield f"the line that there is only on one of the two roads was in view: {share[1].mean():.2f}"
    yield f"that or the outer line of the narrower one was in view: {share[2].mean():.2f}"
    yield f"found among these: {share[0][share[2]].mean():.2f}"
    yield f"found among the others: {share[0][~share[2]].mean():.2f}"
    for (doubt, where), each in right.items():
        both = np.sum(each, axis=0)
        accuracy, is_sure, of_sure = both[0] / both[1], both[3] / both[1], both[2] / both[3]
        yield (
            f"{doubt}: right lane {where} in {accuracy:.3f} of {both[1]} frames; beliefs of"
            f" {_SURE:g} and more in {is_sure:.3f}, {of_sure:.3f} of them right"
        )


def _mark_guesses(
    folder: Path, wrong: Sequence[tuple[int, int]], n_frames: int, rate: float, seed: int
) -> BoolArray:
    """Writes the road table with guesses to `guessed.parquet`. (T,): whether a frame has one."""
    is_guess = np.zeros(n_frames, dtype=bool)
    for a, b in wrong:
        is_guess[a:b] = True
    needed, piece = _RIGHT_PARTS * is_guess.sum(), round(_PIECE_S * rate)
    for start in np.random.default_rng(seed).permutation(np.arange(0, n_frames, piece)):
        here = is_guess[start : start + piece]
        if needed > 0 and not here.any():
            needed -= len(here)
            here[:] = True
    table = road_table.load(folder / "road.parquet")
    frame = np.clip(np.round(table.t_s * rate).astype(np.int64), 0, n_frames - 1)
    guessed = replace(table, untold=is_guess[frame].astype(np.int64))
    road_table.save(guessed, folder / "guessed.parquet")
    return is_guess


def _stretches(error: IntArray, least: int) -> list[tuple[int, int]]:
    """The first frames and the ends of stretches of one error that is not 0."""
    ends = np.flatnonzero(np.diff(error, prepend=0, append=0))
    return [(a, b) for a, b in pairwise(ends.tolist()) if error[a] and b - a >= least]
