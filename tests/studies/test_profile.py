"""Profiles: against a grid of everything, the bootstrap by hand, and resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.drives import Drive
from egolane_pgm.loading import load_experiment
from egolane_pgm.scoring.bootstrap import bootstrap_interval
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.studies import profile as module
from egolane_pgm.studies.fits import search_space
from egolane_pgm.studies.objective import beliefs_at, score_of
from egolane_pgm.studies.profile import make_profile, values_of
from egolane_pgm.studies.study import Study, Work, run_study
from egolane_pgm.types import InputError
from tests.conftest import needs_compiler
from tests.kits.drives import done, simulated, write_drive
from tests.kits.processes import started
from tests.kits.studies import drive_of, fitting, two_drives

pytestmark = needs_compiler

HELD = dict.fromkeys(("p1", "p2", "p3", "p4", "sigma2"), 0.7)


def profiled(drive: Drive, names: Any, trials: int = 30, **fit: Any) -> Study:
    work = Work(fit.pop("directory", None))
    given = fitting(drive, trials=trials, **fit)
    return run_study([given], "tune", [], work, profile=names)


def test_a_profile_finds_what_a_grid_of_the_other_parameters_finds() -> None:
    """sigma1 with bonus_value: ten values; and p1 with sigma1, which is a number."""
    drive = drive_of(simulated(recording={"simulate": "quickstart", "frames": [0, 300]}))
    beliefs, used = beliefs_at(drive), np.ones(len(drive), dtype=bool)

    def score(**changes: Any) -> float:
        found = beliefs({**drive.model.parameters, **HELD, **changes})
        return score_of([drive], [found], [used], "log_loss")

    study = profiled(drive, ["sigma1"], parameters=HELD, objective="log_loss")
    for value, found in zip(study.profile["value"], study.profile["score"], strict=True):
        best = min(score(sigma1=value, bonus_value=bonus) for bonus in range(10))
        assert found == pytest.approx(best)
    only = {**HELD, "bonus_value": 3}
    del only["p1"]
    study = profiled(drive, ["p1"], parameters=only, objective="log_loss")
    for value, found in zip(study.profile["value"], study.profile["score"], strict=True):
        grid = [score(bonus_value=3, p1=value, sigma1=s) for s in np.geomspace(0.05, 3, 60)]
        assert found < min(grid) + 1e-3


@pytest.mark.parametrize("name", ["accuracy", "log_loss"])
def test_a_value_is_ruled_out_by_the_interval_of_its_difference_to_the_best(name: str) -> None:
    """Two searched parameters, of which one is profiled alone: every point is known."""
    drive = drive_of(simulated())
    held = {**HELD, "bonus_value": 3}
    profile = profiled(drive, ["sigma1"], parameters=held, objective=name).profile
    rows, counts = drive.rows, []
    for value in profile["value"]:
        beliefs = beliefs_at(drive)({**drive.model.parameters, **held, "sigma1": value})
        truth = drive.true_lane[rows], drive.is_crossing[rows]
        answers = Answers(beliefs.lane, *truth, assigned_lane(beliefs.lane), frame_rate=10.0)
        counts.append(SCORES[name].summands(answers))
    sign = 1 if name == "accuracy" else -1
    best = int((sign * profile["score"]).argmax())
    assert profile["difference"][best] == 0
    for row, mine in zip(profile.itertuples(), counts, strict=True):
        pair = [counts[best], mine][::sign]
        loss = bootstrap_interval([pair[0]], SCORES[name].statistic, minus=[pair[1]])
        assert (row.difference, row.low) == pytest.approx((loss.estimate, loss.low))
        assert row.is_ruled_out == (loss.low is not None and loss.low > 0)
    assert 0 < profile["is_ruled_out"].sum() < len(profile)


def test_a_profile_is_saved_and_another_process_searches_nothing_again(tmp_path: Path) -> None:
    path, out = write_drive(tmp_path, 100), tmp_path / "out"
    words = ["tune", path, "--trials", 12, "--folds", 0, "--profile", "bonus_value", "--out", out]
    shown = done(*words).stdout
    assert "profile of accuracy (in-sample), others searched again" in shown
    assert max(map(len, shown.splitlines()[:-1])) <= 80
    first, kept = pd.read_parquet(out / "profile.parquet"), set(out.glob("profiled/*.parquet"))
    assert first["value"].tolist() == list(range(10))
    assert len(kept) == 10 * module.PASSES
    with started(*words) as again:
        again.communicate()
    assert again.returncode == 0
    assert set(out.glob("profiled/*.parquet")) == kept
    pd.testing.assert_frame_equal(pd.read_parquet(out / "profile.parquet"), first)


@pytest.mark.parametrize("pooled", [False, True])
def test_a_profile_of_several_drives_has_their_score(
    pooled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "STEPS", 2)
    drives = [fitting(each, trials=10, parameters=HELD) for each in two_drives()]
    study = run_study(drives, "tune", [], Work(pooled=pooled))
    found = make_profile(drives, ["sigma1"], study.trials, pooled=pooled)
    assert found["score"].max() >= study.trials["accuracy"].max() - 1e-9
    row = found[found["value"] == study.trials.loc[study.trials["accuracy"].idxmax(), "sigma1"]]
    assert row["score"].item() >= study.trials["accuracy"].max() - 1e-9


def test_values_lie_over_the_range_and_a_short_drive_has_no_interval() -> None:
    drive = drive_of(load_experiment("quickstart", {"recording.frames": [0, 400]}))
    given = {"sigma1": [0.2, 0.5], "sigma2": [0.5, 2]}
    tuning = fitting(drive, parameters=given).experiment.fit
    space = search_space([drive.model], tuning)
    for name, count, low, high in (
        ("p1", 11, 1e-6, 1 - 1e-6),
        ("sigma1", 11, 0.2, 0.5),
        ("sigma2", 25, 0.5, 2),
        ("bonus_value", 10, 0, 9),
    ):
        values = values_of(space, name)
        assert (len(values), values[0], values[-1]) == pytest.approx((count, low, high))
    profile = profiled(drive, ["sigma1"], trials=4, parameters={**HELD, "bonus_value": 3}).profile
    assert profile["low"].isna().all()
    assert not profile["is_ruled_out"].any()
    with pytest.raises(InputError, match="profile: no number 'p5' is searched"):
        profiled(drive, ["p5"])
