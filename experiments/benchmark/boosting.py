"""A learned answer without a model of the road: gradient boosting on line lists, and a filter that
stays in its lane.

The classifier is asked of each frame and each lane whether the car is in it, so that one is learned
for every number of lanes. It sees the nearest lines on either side and how much was seen in the
last seconds. Hyperparameters of the filter are chosen on drives that the classifier did not see.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from scipy.signal import lfilter
from sklearn.ensemble import HistGradientBoostingClassifier
from threadpoolctl import threadpool_limits

from egolane_pgm.benchmark.entries import Answer, Answering
from egolane_pgm.benchmark.tracks import RATE, Recording
from egolane_pgm.inference.events import lane_events
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import Beliefs, FloatArray, LineLog

#: Lines on either side that are looked at.
_NEAR = 3

#: Over how many seconds is averaged what was seen.
_MEMORY_S = (1.0, 10.0, 60.0)

#: Every so many frames is learned from: neighbours are alike.
_EVERY = 20

#: How probable it is to stay in the lane, and the weight of a frame, from which a pair is chosen.
_STAYS, _WEIGHTS = (0.99, 0.999, 0.9999), (0.03, 0.1, 0.3)


def fit(recordings: Sequence[Recording]) -> Answering:
    """What answers after looking at recordings with their lanes."""
    drives = sorted({each.drive for each in recordings})
    kept = [each for each in recordings if drives.index(each.drive) % 4]
    rest = [each for each in recordings if not drives.index(each.drive) % 4]
    first = _classifier(kept)
    asked = [
        (each, _shares(first, each.log, each.n_lanes)) for each in rest[:: max(1, len(rest) // 16)]
    ]

    def right(stay: float, weight: float) -> float:
        found = []
        for each, shares in asked:
            lane = assigned_lane(_filtered(shares, stay, weight))
            found.append((lane == each.truth.lane)[~each.truth.is_crossing].mean())
        return float(np.mean(found))

    stay, weight = max(product(_STAYS, _WEIGHTS), key=lambda pair: right(*pair))
    return partial(_answer, _classifier(recordings), stay, weight)


def _answer(classifier: Any, stay: float, weight: float, recording: Recording) -> Answer:
    begun = time.perf_counter()
    log = recording.log
    belief = _filtered(_shares(classifier, log, recording.n_lanes), stay, weight)
    zeros = np.zeros(len(log))
    beliefs = Beliefs(log.frame_id, {"Lane": belief}, zeros, zeros.astype(bool))
    return Answer(belief, lane_events(beliefs, RATE), time.perf_counter() - begun)


def _classifier(recordings: Sequence[Recording]) -> Any:
    rows, lanes = [], []
    for each in recordings:
        seen = features(each.log)[::_EVERY][~each.truth.is_crossing[::_EVERY]]
        lane = each.truth.lane[::_EVERY][~each.truth.is_crossing[::_EVERY]]
        rows.append(of_lanes(seen, each.n_lanes).reshape(len(seen) * each.n_lanes, -1))
        lanes.append((lane[:, None] == np.arange(1, each.n_lanes + 1)).ravel())
    classifier = HistGradientBoostingClassifier(
        max_iter=100, learning_rate=0.1, l2_regularization=1.0, min_samples_leaf=50, random_state=0
    )
    # Its threads wait for each other where others share the machine.
    with threadpool_limits(1):
        return classifier.fit(np.concatenate(rows), np.concatenate(lanes))


def _shares(classifier: Any, log: LineLog, n_lanes: int) -> FloatArray:
    """(T, n): how the classifier shares out each frame over the lanes."""
    rows = of_lanes(features(log), n_lanes)
    with threadpool_limits(1):
        odds = classifier.predict_proba(rows.reshape(-1, rows.shape[-1]))[:, 1]
    odds = odds.reshape(-1, n_lanes)
    return np.asarray(odds / odds.sum(axis=1, keepdims=True))


def _filtered(shares: FloatArray, stay: float, weight: float) -> FloatArray:
    """(T, n): a lane is kept with probability `stay`, else drawn anew; `weight` tempers frames,
    because neighbouring ones repeat their mistakes."""
    belief = np.empty_like(shares)
    n_lanes = shares.shape[1]
    now = np.full(n_lanes, 1 / n_lanes)
    for t, likelihood in enumerate(shares**weight):
        now = (stay * now + (1 - stay) / n_lanes) * likelihood
        now /= now.sum()
        belief[t] = now
    return belief


def features(log: LineLog) -> FloatArray:
    """(T, F): what is seen in each frame and was seen before it: of the nearest valid lines on
    either side offset, flag and LRI, then means over the last seconds of these and of how many
    lines there are on either side."""
    is_there = log.is_valid & (np.abs(log.offset_m) > 1e-6)
    columns = []
    for side in (-1, 1):
        away = np.where(is_there & (np.sign(log.offset_m) == side), np.abs(log.offset_m), np.inf)
        columns.append(np.isfinite(away).sum(axis=1).astype(float))
        order = np.argsort(away, axis=1, kind="stable")[:, :_NEAR]
        for values in (away, log.is_continuous.astype(float), log.lri):
            near = np.take_along_axis(values, order, axis=1)
            near = np.where(np.isfinite(np.take_along_axis(away, order, axis=1)), near, np.nan)
            columns += list(
                np.pad(near, ((0, 0), (0, _NEAR - order.shape[1])), constant_values=np.nan).T
            )
    seen = np.column_stack(columns)
    means = []
    for memory in _MEMORY_S:
        kept = np.exp(-1 / (memory * RATE))
        # What is not seen counts as nothing; the sums begin at zero and say how much was there.
        means.append(lfilter([1 - kept], [1, -kept], np.nan_to_num(seen), axis=0))
    return np.column_stack([seen, *means])


def of_lanes(seen: FloatArray, n_lanes: int) -> FloatArray:
    """(T, n, F + 3): the features of each frame for each lane: the lane, those right of it, n."""
    lane = np.arange(1.0, n_lanes + 1)
    places = np.column_stack([lane, n_lanes - lane, np.full(n_lanes, float(n_lanes))])
    return np.concatenate(
        [
            np.repeat(seen[:, None], n_lanes, axis=1),
            np.repeat(places[None], len(seen), axis=0),
        ],
        axis=2,
    )
