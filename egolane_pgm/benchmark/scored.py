"""The scores of an entry: of each recording what its scores are made of, as JSON.

Every score of a track is a sum over recordings over another one, so that whoever has these sums
can resample recordings. They are made by the functions of `scoring`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from egolane_pgm.benchmark.causality import CUTS, Check, check_causality, drawn
from egolane_pgm.benchmark.entries import Answer, Answering
from egolane_pgm.benchmark.tracks import RATE, SHOWN_ONLY, Recording
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import RESAMPLES
from egolane_pgm.scoring.confusion import confusion, recall
from egolane_pgm.scoring.events import event_delays, score_events
from egolane_pgm.scoring.probabilistic import calibration_curve, log_loss_per_frame
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.types import FloatArray, InputError, runs_of

#: The version of the keys in a file of scores.
VERSION = 1

#: A belief from here on is sure.
SURE = 0.95

#: How much of the beginning of a drive is scored apart, seconds.
BEGINNING_S = 60.0

#: The tolerance of lane changes, seconds.
WITHIN_S = "2"

#: The sums that each score is made of: what is above and what is below.
SCORES: Mapping[str, tuple[str, str]] = {
    "accuracy": ("recalls", "lanes_driven"),
    "frames_right": ("right", "scored"),
    "log_loss": ("losses", "frames"),
    "sure": ("sure", "scored"),
    "right_if_sure": ("sure_right", "sure"),
    "first_minute": ("beginning_right", "beginning"),
    "precision": ("changes_right", "changes_told"),
    "recall": ("changes_right", "changes"),
    "false_per_hour": ("changes_false", "hours"),
    "lanes_found": ("lanes_found", "recordings"),
    "ms_per_frame": ("ms", "frames_timed"),
}


def score_recording(recording: Recording, answer: Answer) -> dict[str, Any]:
    """What the scores of a recording are made of, ready for JSON.

    The keys are those of SCORES, whose sums over recordings make the scores, and `wrong_s` (the
    longest wrong stretch, seconds), `delays_s` (of the reported lane changes that are right),
    `reliability` (per bin of the largest probability: frames, sum of it, right ones).
    """
    truth, n_told = recording.truth, answer.belief.shape[1]
    n_lanes = max(recording.n_lanes, n_told)
    belief = np.pad(answer.belief, ((0, 0), (0, n_lanes - n_told)))
    assigned = assigned_lane(belief)
    matrix = confusion(assigned, truth.lane, truth.is_crossing, n_lanes)
    is_driven = matrix.sum(axis=0) > 0
    scored = ~truth.is_crossing
    right = (assigned == truth.lane) & scored
    sure = (belief.max(axis=1) > SURE) & scored
    first = scored & (recording.log.time_s - recording.log.time_s[0] < BEGINNING_S)
    wrong = runs_of(~right[scored])
    curve = calibration_curve(belief, truth.lane, truth.is_crossing)
    sums = {
        "recalls": recall(matrix)[is_driven].sum(),
        "lanes_driven": is_driven.sum(),
        "losses": log_loss_per_frame(belief, truth.lane).sum(),
        "frames": len(truth),
        "right": right.sum(),
        "sure": sure.sum(),
        "sure_right": (sure & right).sum(),
        "scored": scored.sum(),
        "beginning": first.sum(),
        "beginning_right": (right & first).sum(),
        "lanes_found": float(n_told == recording.n_lanes),
        "recordings": 1.0,
        "ms": 1000 * (answer.seconds or 0.0),
        "frames_timed": len(truth) if answer.seconds is not None else 0,
    }
    facts = ("track", "name", "driver", "drive", "donor", "n_lanes")
    return {
        **{key: getattr(recording, key) for key in facts},
        **{key: float(value) for key, value in sums.items()},
        **_events(recording, answer),
        "wrong_s": max((b - a for a, b in wrong), default=0) / RATE,
        "reliability": [
            curve.count.tolist(),
            (np.nan_to_num(curve.confidence) * curve.count).tolist(),
            (np.nan_to_num(curve.accuracy) * curve.count).tolist(),
        ],
    }


def _events(recording: Recording, answer: Answer) -> dict[str, Any]:
    """The sums of the reported lane changes; zeros where none were asked of the entry."""
    keys = ("changes", "changes_right", "changes_false", "changes_told", "hours")
    if answer.told is None:
        return {**dict.fromkeys(keys, 0.0), "delays_s": []}
    found = score_events(answer.told, recording.truth, RATE)
    within = found["within"][WITHIN_S]
    right, false = within["right"], within["false"]
    counts = (found["changes"], right, false, right + false, found["hours"])
    delays = event_delays(answer.told, recording.truth, RATE)
    return {
        **{key: float(value) for key, value in zip(keys, counts, strict=True)},
        "delays_s": delays[~np.isnan(delays)].tolist(),
    }


# --- an entry ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """What is scored.

    - title: how tables call it.
    - answering: answers for a recording; of an entry that is fitted None.
    - fit: what answers after looking at recordings with their truth: each driver's are answered
      for by what never saw them.
    - can_rerun: whether it answers again for a part of a recording.
    """

    title: str
    answering: Answering | None
    fit: Callable[[Sequence[Recording]], Answering] | None = None
    can_rerun: bool = True


def score_entry(
    entry: Entry,
    recordings: Sequence[Recording],
    *,
    checked: int = 5,
    cuts: int = CUTS,
    seed: int = 0,
    find_lanes: bool = False,
    jobs: Jobs = 1,
) -> dict[str, Any]:
    """The scores of an entry on recordings, ready for JSON.

    - checked: on how many recordings causality is checked, `cuts` cuts each.
    - find_lanes: whether the entry has to find the number of lanes.
    - jobs: processes that share the recordings.
    """
    shown = "unknown" if find_lanes else "given"
    found: list[dict[str, Any]] = []
    check = Check()
    for answering, part in _folds(entry, recordings, jobs):
        found += in_order(partial(_scored, answering, find_lanes), part, jobs)
        if entry.can_rerun and checked and not check.cuts:
            asked = partial(_asked, answering, find_lanes)
            check = check_causality(asked, drawn(part, checked, seed), cuts, seed)
    return {
        "version": VERSION,
        "title": entry.title,
        "fitted": entry.fit is not None,
        "lanes": shown,
        "check": {**asdict(check), "is_causal": check.is_causal},
        "recordings": found,
    }


def _folds(
    entry: Entry, recordings: Sequence[Recording], jobs: Jobs
) -> list[tuple[Answering, Sequence[Recording]]]:
    """What answers for which recordings."""
    if entry.fit is None:
        assert entry.answering is not None
        return [(entry.answering, recordings)]
    ranked = [each for each in recordings if each.track not in SHOWN_ONLY]
    # What is only shown is answered for by what saw all that is ranked.
    held_out = {id(each): each.driver for each in ranked}
    folds = list(dict.fromkeys(held_out.get(id(each)) for each in recordings))
    others = [[each for each in ranked if each.driver != driver] for driver in folds]
    if not all(others):
        raise InputError(f"{entry.title}: is fitted to the drives of others; give it more tracks")
    return [
        (answering, [each for each in recordings if held_out.get(id(each)) == driver])
        for driver, answering in zip(folds, in_order(entry.fit, others, jobs), strict=True)
    ]


def _asked(answering: Answering, find_lanes: bool, recording: Recording) -> Answer:
    return answering(replace(recording, n_lanes=0) if find_lanes else recording)


def _scored(answering: Answering, find_lanes: bool, recording: Recording) -> dict[str, Any]:
    return score_recording(recording, _asked(answering, find_lanes, recording))


# --- several recordings ------------------------------------------------------------------------


def resamples(recordings: Sequence[Mapping[str, Any]], seed: int = 0) -> FloatArray:
    """(1 + R, D): all D recordings, then how often each is drawn in R resamples: drivers first,
    then drives of each of them, with all recordings of a drive."""
    rng = np.random.default_rng(seed)
    tree: dict[str, dict[str, list[int]]] = {}
    for k, each in enumerate(recordings):
        tree.setdefault(each["driver"], {}).setdefault(each["drive"], []).append(k)
    drivers = [list(drives.values()) for drives in tree.values()]
    weights = np.zeros((1 + RESAMPLES, len(recordings)))
    weights[0] = 1
    for row in weights[1:]:
        for k in rng.integers(0, len(drivers), len(drivers)):
            for drive in rng.integers(0, len(drivers[k]), len(drivers[k])):
                row[drivers[k][drive]] += 1
    return weights


def total(recordings: Sequence[Mapping[str, Any]], score: str, weights: FloatArray) -> FloatArray:
    """A score of D recordings, counted as each row of `weights` (R, D) says: (R,); NaN where it is
    not defined."""
    above, below = (
        weights @ np.array([each[key] for each in recordings], dtype=np.float64)
        for key in SCORES[score]
    )
    return np.asarray(above / np.where(below == 0, np.nan, below))
