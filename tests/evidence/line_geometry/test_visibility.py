"""The belief over what a detector shows on this road."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.model import CLUTTER_PER_M, LANE_M, TABLE_STEP_M
from egolane_pgm.evidence.line_geometry.rule import NODES
from egolane_pgm.evidence.line_geometry.visibility import (
    KINDS,
    new_patterns,
    new_visibility,
    visibility_models,
    visibility_tables,
)
from egolane_pgm.types import FloatArray, LineLog
from tests.evidence.line_geometry.test_rule import resolved
from tests.kits.line_logs import line_log
from tests.reference import line_geometry as reference

#: A car in the middle of a lane: its own lines, and those with the next ones on either side.
OWN = [-1.75, 1.75]
FOUR = [-5.25, -1.75, 1.75, 5.25]


def beliefs(log: LineLog, n_lanes: int = 3, **given: object) -> FloatArray:
    """What the evidence says of the lanes, added up over the frames, (n,)."""
    parameters = resolved(n_lanes, lane_width_m=LANE_M, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        likelihood = line_geometry.evidence(log, n_lanes, parameters).likelihoods[NODES]
    of_lane = likelihood[..., 0].reshape(len(log), n_lanes, -1).max(axis=2)
    total = np.log(of_lane).sum(axis=0)
    share: FloatArray = np.exp(total - total.max())
    return share / share.sum()


@pytest.mark.parametrize("n_lanes", [3, 5])
def test_a_camera_of_two_lines_is_no_evidence_of_the_lane(n_lanes: int) -> None:
    log = line_log(OWN * np.ones((3000, 1)))
    assert beliefs(log, n_lanes, clutter=CLUTTER_PER_M.tolist()).min() < 0.1
    np.testing.assert_allclose(beliefs(log, n_lanes), 1 / n_lanes, atol=0.25 / n_lanes)


def test_a_line_that_is_shown_counts_on() -> None:
    """Both next lines are seen for a minute: the middle lane of three. Then no more, and that says
    as little as of a camera of two lines."""
    offsets = np.full((3600, 4), np.nan)
    offsets[:600] = FOUR
    offsets[600:, :2] = OWN
    log = line_log(offsets)
    before = beliefs(log.take(slice(0, 600)))
    assert before.argmax() == 1
    assert before[1] > 0.99
    assert beliefs(log).argmax() == 1


def test_own_lines_alone_are_noted() -> None:
    parameters = resolved(lane_width_m="causal")
    with pytest.warns(UserWarning, match="shows the lines of its own lane only"):
        line_geometry.evidence(line_log(OWN * np.ones((3000, 1))), 3, parameters)
    with pytest.warns(UserWarning, match="lane width") as messages:
        line_geometry.evidence(line_log(FOUR * np.ones((3000, 1))), 3, parameters)
    assert not any("own lane only" in str(each.message) for each in messages)


def test_what_is_given_or_learned_leaves_one_kind() -> None:
    assert len(visibility_models(3, resolved())) == len(KINDS)
    assert len(visibility_models(3, resolved(sigmas_m=[0.2] * 6))) == 1


@pytest.mark.parametrize("module", [kernels, reference])
def test_in_one_lane_that_is_never_left_the_kinds_are_averaged_exactly(module: object) -> None:
    """With one lane, one cell, and kinds that never change, the product of the frames' evidence is
    the mean over the kinds of the product of theirs."""
    parameters = resolved(1, cells=1)
    tables = visibility_tables(visibility_models(1, parameters), has_flags=True)
    rng = np.random.default_rng(0)
    offsets = rng.choice(FOUR, (30, 3)) + rng.normal(0, 0.2, (30, 3))
    kind = rng.integers(-1, 4, (30, 3))
    kind[:, 0] = 1

    def likelihood(log_intensity: FloatArray, expected: FloatArray, kinds: int) -> FloatArray:
        """Relative to the mean one, which is that of the state BAD with beta 1."""
        found = np.empty((30, 1, 2))
        module.weigh_positions(  # type: ignore[attr-defined]
            *(offsets, kind, np.full((30, 1), LANE_M), log_intensity, tables.log_mean),
            *(tables.first_m, TABLE_STEP_M, expected, LANE_M, 1.0, 1.0, np.ones(30)),
            *(np.zeros(30, dtype=bool), 0.0, 0.0, new_visibility(1, kinds), new_patterns()),
            *(found, np.empty(30)),
        )
        return found[:, 0, 0] / found[:, 0, 1]

    whole = likelihood(tables.log_intensity, tables.expected, len(KINDS))
    alone = [
        likelihood(np.ascontiguousarray(tables.log_intensity[..., [k]]), tables.expected[[k]], 1)
        # The mean of one kind is its own expected number of lines.
        * np.exp(tables.expected.mean() - tables.expected[k].mean())
        for k in range(len(KINDS))
    ]
    np.testing.assert_allclose(whole.prod(), np.prod(alone, axis=1).mean(), rtol=1e-9)
