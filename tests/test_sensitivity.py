"""Sensitivity: runs with the other number, bounds and gaps."""

from __future__ import annotations

from dataclasses import replace

import pytest

import egolane_pgm as ego
from tests.kits.drives import run

SCORES = [f"{score}_{side}" for score in ("log_loss", "log_evidence") for side in ("down", "up")]
LANES = (1, 2, 3, 4)
SHORT = {"recording.frames": [0, 300], "filter": "exact"}


def test_each_change_is_that_of_a_run_with_the_other_number() -> None:
    result = run("quickstart", SHORT, graph="wor_on_lane")
    found = ego.sensitivity(result, step=0.1)
    assert list(found.index) == [
        "bonus_value",
        "sigma1",
        "sigma2",
        "p1",
        "p2",
        *(f"{p}[{k}]" for p in ("p3", "p4") for k in LANES),
    ]
    # A tenth of the range that a search has.
    assert found.loc["sigma1", "value_high"] == pytest.approx(found.loc["sigma1", "value"] + 0.3)
    before = result.scores["model"]
    for name, row in found.iterrows():
        parameter, is_lane, lane = str(name).partition("[")
        for side, end in (("down", "low"), ("up", "high")):
            moved: object = row[f"value_{end}"]
            if is_lane:
                moved = [moved if f"{k}]" == lane else row["value"] for k in LANES]
            there = run(
                "quickstart", {**SHORT, f"parameters.{parameter}": moved}, graph="wor_on_lane"
            )
            after = there.scores["model"]
            for score in ("accuracy", "log_loss"):
                gain = after[score] - before[score]
                assert row[f"{score}_{side}"] == pytest.approx(gain, abs=1e-12)
            if name != "bonus_value":
                gain = (there.frames["log_evidence"] - result.frames["log_evidence"]).sum()
                assert row[f"log_evidence_{side}"] == pytest.approx(gain, abs=1e-9)


def test_incomparable_log_evidence_is_left_empty() -> None:
    values = {"parameters.p1": 1.0, "parameters.bonus_value": 9}
    found = ego.sensitivity(run("quickstart", {**SHORT, **values, "filter": "smoothed"}))
    assert found.loc["p1", ["value", "value_high"]].tolist() == [1.0, 1.0]
    assert found.loc["p1", SCORES].isna().tolist() == [False, True, False, True]
    rule = found.loc["bonus_value"]
    assert rule[["value_low", "value_high"]].tolist() == [8.91, 9]
    assert rule[SCORES].isna().tolist() == [False, True, True, True]
    blind = ego.sensitivity(run("quickstart", SHORT, ground_truth="none"))
    assert blind.filter(regex="accuracy|log_loss").isna().all(axis=None)
    assert blind.loc["sigma1", SCORES[2:]].notna().all()


def test_a_step_or_result_that_does_not_fit_is_refused() -> None:
    result = run("quickstart", {"recording.frames": [0, 9]})
    with pytest.raises(ego.InputError, match="step: 2 is not a share"):
        ego.sensitivity(result, step=2)
    with pytest.raises(ego.InputError, match="quickstart: has several drives"):
        ego.sensitivity(replace(result, frames=result.frames.assign(drive="a")))
