"""Beliefs that are sure, and wrong: every score is a number or undefined, and nothing warns."""

from __future__ import annotations

import json
import warnings

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.inference.events import lane_events
from egolane_pgm.scoring import score_all
from egolane_pgm.scoring.events import Reported, score_crossing, score_events
from egolane_pgm.scoring.probabilistic import SMALLEST_PROBABILITY
from egolane_pgm.types import Beliefs, lane_truth

#: What a lane may have; the last one gets the rest.
SHARES = (0.0, 5e-324, 1e-300, 1e-16, 1.0)


@given(st.integers(2, 5), st.sampled_from([1, 2, 40, 700]), st.integers(0, 2**32 - 1))
def test_sure_beliefs_have_plain_scores(n_lanes: int, n_frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lane = rng.choice(SHARES, (n_frames, n_lanes))
    lane[np.arange(n_frames), rng.integers(n_lanes, size=n_frames)] = 1.0
    lane /= lane.sum(axis=1, keepdims=True)
    # Lanes are held for a while, so that there are changes to be late for.
    true = np.repeat(rng.integers(1, n_lanes + 1, -(-n_frames // 20)), 20)[:n_frames]
    is_crossing = rng.random(n_frames) < 0.2
    ids = np.arange(n_frames)
    truth = lane_truth(ids, true, is_crossing)
    beliefs = Beliefs(ids, {"Lane": lane}, np.zeros(n_frames), np.zeros(n_frames, dtype=bool))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scores = score_all(lane, truth, 10.0)
        reported = Reported(lane_events(beliefs, 10.0), truth, rng.choice(SHARES, n_frames))
        events = score_events([reported], 10.0)
        warned = score_crossing([reported], 10.0)
    # Neither NaN nor infinity.
    json.dumps([scores, events, warned], allow_nan=False)
    assert 0 <= scores["log_loss"] <= -np.log(SMALLEST_PROBABILITY)
