"""Recordings that no detector should make, or no driver: beliefs stay beliefs, and as right as the
lines allow. The accuracies are those that the model has, with a margin; a better model may raise
them, none should fall below."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import make_evidence, online_rule
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.types import Beliefs
from makers.beyond.strangers import accuracies, zero_label
from tests.conftest import needs_compiler
from tests.kits.strangers import (
    STRANGERS,
    Drive,
    paper_drive,
    simulated_drive,
)

#: What the share of right lanes is at least, on runs 1 and 6.
LEVELS = {
    "no line valid, LRI unknown": (0.99, 0.99),
    "scale x 0.6 from the middle on": (0.74, 0.70),
    "half of the lines mirrored": (0.30, 0.63),
    "the nearest line only": (0.80, 0.89),
    "stands still for ten minutes": (0.995, 0.995),
    "begins in a lane change": (0.99, 0.99),
    "clock jumps by an hour": (0.99, 0.99),
    "clock jumps back by an hour": (0.99, 0.99),
}


@cache
def simulated() -> Drive:
    return simulated_drive("a4", 2, 900)


def beliefs_of(drive: Drive) -> Beliefs:
    model = zero_label(drive.n_lanes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        evidence, _ = make_evidence(model, drive.log)
    return filter_beliefs(model.compiled, evidence)


@needs_compiler
@pytest.mark.parametrize("name", STRANGERS)
def test_beliefs_about_any_stranger_are_beliefs(name: str) -> None:
    for drive in STRANGERS[name](simulated())[:2]:
        beliefs = beliefs_of(drive)
        assert len(beliefs) == len(drive.log)
        assert not beliefs.is_impossible.any()
        for marginal in beliefs.marginals.values():
            assert (marginal >= 0).all()
            np.testing.assert_allclose(marginal.sum(axis=1), 1, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize("name", LEVELS)
def test_a_stranger_gets_the_same_evidence_frame_by_frame(name: str) -> None:
    (drive,) = STRANGERS[name](simulated())
    log = drive.log.take(slice(0, 450))
    model = zero_label(drive.n_lanes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        at_once, _ = make_evidence(model, log)
        rule, frames = online_rule(model), [log.take(slice(t, t + 1)) for t in range(len(log))]
        parts = [make_evidence(model, frame, rule)[0] for frame in frames]
    for node, values in at_once.likelihoods.items():
        one_by_one = np.concatenate([part.likelihoods[node] for part in parts])
        np.testing.assert_allclose(one_by_one, values, rtol=1e-12)
    for node, inputs in at_once.inputs.items():
        np.testing.assert_array_equal(np.concatenate([p.inputs[node] for p in parts]), inputs)


@needs_compiler
@pytest.mark.parametrize("name", LEVELS)
def test_strangers_made_of_recordings_are_located_as_well_as_their_lines_allow(
    name: str, recordings: Path
) -> None:
    found = [accuracies(STRANGERS[name](paper_drive(run)))[0] for run in (1, 6)]
    assert (np.array(found) >= LEVELS[name]).all(), found


@needs_compiler
def test_a_clock_that_jumps_changes_no_belief_before_it_and_hardly_one_after(
    recordings: Path,
) -> None:
    drive = paper_drive(1)
    half = len(drive.log) // 2
    expected = beliefs_of(drive).lane
    for name in ("clock jumps by an hour", "clock jumps back by an hour"):
        (jumps,) = STRANGERS[name](drive)
        found = beliefs_of(jumps).lane
        np.testing.assert_array_equal(found[:half], expected[:half])
        assert np.mean(assigned_lane(found) != assigned_lane(expected)) < 0.002


@needs_compiler
def test_half_mirrored_lines_leave_the_belief_unsure(recordings: Path) -> None:
    """Nothing of where the lines are is left; a belief that says otherwise is wrong."""
    (drive,) = STRANGERS["half of the lines mirrored"](paper_drive(1))
    is_scored = drive.lane > 0
    surest = {
        name: beliefs_of(d).lane.max(axis=1)[is_scored].mean()
        for name, d in (("mirrored", drive), ("as recorded", paper_drive(1)))
    }
    assert surest["mirrored"] < 0.8 < 0.95 < surest["as recorded"]
