"""Whether an entry is causal: a recording is cut, and the entry runs again on what is left. A
belief, or a reported lane change, that is another one then looked ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from egolane_pgm.benchmark.entries import Answer, Answering
from egolane_pgm.benchmark.tracks import RATE, Recording

#: Frames at which a recording is cut.
CUTS = 20

#: Beliefs that differ by less are the same: answers are written with few digits.
_SAME = 1e-4


@dataclass(frozen=True)
class Check:
    """What cutting showed.

    - recordings, cuts: how many there were; none: it was not checked.
    - changed: cuts after which an earlier belief or lane change was another one.
    - ahead_s: the furthest that a belief looked ahead, seconds.
    """

    recordings: int = 0
    cuts: int = 0
    changed: int = 0
    ahead_s: float = 0.0

    @property
    def is_causal(self) -> bool | None:
        """None where it was not checked."""
        return None if not self.cuts else not self.changed


def check_causality(
    answering: Answering, recordings: Sequence[Recording], cuts: int = CUTS, seed: int = 0
) -> Check:
    """Cut each recording behind random frames, and compare what the entry says of what is left
    with what it said of the whole."""
    rng = np.random.default_rng(seed)
    done = changed = 0
    furthest = 0
    for each in recordings:
        whole = answering(each)
        n_frames = len(each.log)
        for stop in np.sort(rng.choice(np.arange(1, n_frames), min(cuts, n_frames - 1), False)):
            ahead = _frames_ahead(whole, answering(each.take(slice(0, stop))), each, int(stop))
            done += 1
            changed += ahead > 0
            furthest = max(furthest, ahead)
    return Check(len(recordings), done, changed, furthest / RATE)


def _frames_ahead(whole: Answer, part: Answer, recording: Recording, stop: int) -> int:
    """How many frames before the cut the first belief is that changed; 0: none did."""
    before = whole.belief[:stop]
    if before.shape != part.belief.shape:
        # An entry that finds the number of lanes found another one.
        return stop
    differs = np.abs(before - part.belief).max(axis=1) > _SAME
    if differs.any():
        return stop - int(np.argmax(differs))
    if whole.told is None or part.told is None:
        return 0
    known = recording.log.frame_id[stop - 1]
    kept = whole.told.told_frame_id <= known
    same = len(part.told) == kept.sum() and all(
        np.array_equal(getattr(whole.told, name)[kept], getattr(part.told, name))
        for name in ("told_frame_id", "from_lane", "to_lane")
    )
    return 0 if same else 1


def drawn(recordings: Sequence[Recording], number: int, seed: int = 0) -> list[Recording]:
    """Some recordings, drawn at random, cut to two minutes: a check runs them twenty times."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(recordings), min(number, len(recordings)), replace=False)
    return [recordings[k].take(slice(0, 1200)) for k in sorted(chosen)]
