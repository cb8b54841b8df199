"""Predictive checks: statistics by hand, and a model whose data say nothing against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.checking import Draws, changes_per_hour, mean_run, share
from tests.kits.drives import run

RESULT = run("quickstart", {"recording.frames": [0, 300]})


def test_statistics_by_hand() -> None:
    draws = Draws({"Lane": np.array([[0, 0, 1, 1, 2], [0, 1, 0, 1, 0], [2, 2, 2, 2, 2]])}, 10.0)
    np.testing.assert_allclose(changes_per_hour(draws), np.array([2, 4, 0]) / 0.5 * 3600)
    np.testing.assert_allclose(share("Lane", 1)(draws), [0.4, 0.4, 0])
    np.testing.assert_allclose(mean_run("Lane", 1)(draws), [0.2, 0.1, np.nan])


def test_a_check_has_the_truth_the_posterior_and_the_model() -> None:
    one, sure = "share of lane 1", "always 3"
    own = {"changes": changes_per_hour, one: share("Lane", 0), sure: lambda d: np.full(80, 3.0)}
    found = ego.check(RESULT, own, n=80, seed=5)
    drawn = [f"{what}{which}" for what in ("posterior", "model") for which in ("", "_low", "_high")]
    assert list(found) == ["truth", *drawn, "probability"]
    paths = ego.posterior_paths(RESULT.model, RESULT.evidence, 80, 5)["Lane"]
    right = np.percentile((paths == "1").groupby("path").mean(), (50, 5, 95))
    assert found.loc[one, drawn[:3]].tolist() == right.tolist()
    assert found.truth["changes"] == (RESULT.truth.true_lane.diff()[1:] != 0).sum() / (30 / 3600)
    assert found.loc[sure, [*drawn, "probability"]].tolist() == [3] * 6 + [1]


def test_lines_that_say_nothing_leave_the_posterior_at_the_model() -> None:
    blank = {key: np.ones_like(values) for key, values in RESULT.evidence.likelihoods.items()}
    result = replace(RESULT)
    vars(result)["evidence"] = ego.Evidence(blank)
    found = ego.check(result, n=4000)
    np.testing.assert_allclose(found.posterior, found.model, rtol=0.1)
    assert (found.probability > 0.8).all()


def test_the_counts_of_a_calibration_add_up() -> None:
    found = ego.prediction_calibration(RESULT, n_bins=5)
    for node, likelihood in RESULT.evidence.likelihoods.items():
        ordered = np.sort(likelihood, axis=1)
        clear, rows = (ordered[:, -1] > ordered[:, -2]).sum(), found[found.node == node]
        assert rows["count"].sum() == clear * likelihood.shape[1]
        np.testing.assert_allclose((rows["count"] * rows.comes).sum(), clear)
        np.testing.assert_allclose((rows["count"] * rows.predicted).sum(), clear)


def test_draws_without_a_value_do_not_count() -> None:
    """Of the draws of the model, half have no value; all others are above the posterior's."""
    states = iter([np.zeros(80), np.tile([np.nan, 1.0], 40)])
    found = ego.check(RESULT, {"half": lambda draws: next(states)}, n=80)
    assert found.loc["half", ["model", "probability"]].tolist() == [1, 0]


def test_a_result_that_cannot_be_checked_is_refused() -> None:
    with pytest.raises(ego.InputError, match=r"check: rain: no node 'Rain'; there are .*Lane"):
        ego.check(RESULT, {"rain": share("Rain", 0)}, n=2)
    for changes, message in (
        ({"frames": RESULT.frames.assign(drive="a")}, "has several drives"),
        ({"lines": {}}, "has no lines"),
        ({"run": {**RESULT.run, "fit": "tune"}}, "is held out, with a model per block"),
    ):
        with pytest.raises(ego.InputError, match=f"check: quickstart: {message}"):
            ego.check(replace(RESULT, **changes))
