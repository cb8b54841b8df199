"""The text and the figures of a study show the trials that it keeps."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.runs import open_input
from egolane_pgm.studies.study import Study, Work, block_folds, run_study
from egolane_pgm.types import InputError
from egolane_pgm.views.studies import (
    draw_study,
    front_figure,
    history_figure,
    pareto_front,
    profile_figure,
    profile_table,
    read_trials,
)
from tests.kits.drives import simulated


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    recording, fit = {"simulate": "quickstart", "frames": [0, 400]}, {"sampler": "random"}
    drives = open_input(simulated(recording=recording, fit={**fit, "trials": 24})).drives()
    folder = tmp_path_factory.mktemp("study")
    return run_study(drives, "tune", block_folds(drives, 2), work=Work(folder))


def test_a_study_has_scores_in_sample_and_held_out_and_the_best_parameters(
    study: Study,
) -> None:
    in_sample, held_out = (
        found.scores["model"]["accuracy"] for found in (study.in_sample, study.held_out) if found
    )
    title = f"'a': tune, 24 trials, accuracy {in_sample:.3f} in-sample, {held_out:.3f} held out"
    assert repr(study) == f"Study({title})"
    text = study.to_text()
    assert text.startswith(title)
    assert "| sigma1 " in text
    assert "in-sample" in study.to_text(style="csv").splitlines()[0]
    assert max(map(len, text.splitlines())) <= 80


def test_a_study_is_drawn_from_its_directory(study: Study, tmp_path: Path) -> None:
    assert study.directory is not None
    files = draw_study(study.directory, tmp_path, "svg")
    assert [file.name for file in files] == ["history.svg", "profile.svg"]
    assert all(file.stat().st_size > 1000 for file in files)
    document, trials = read_trials(study.directory)
    assert len(trials) == 24
    for name, damage in (("study.json", "{"), ("study.json", "{}"), ("trials.parquet", "PAR1")):
        copy = shutil.copytree(study.directory, tmp_path / "copy", dirs_exist_ok=True)
        (copy / name).write_text(damage)
        with pytest.raises(InputError, match=r"copy: cannot be read as a study \("):
            read_trials(copy)
    lines = history_figure(trials, document, "").axes[0].lines
    best = next(line for line in lines if str(line.get_label()).startswith("best"))
    np.testing.assert_array_equal(best.get_ydata(), trials["score"].cummax())
    assert study.held_out is not None
    assert set(np.asarray(lines[-1].get_ydata())) == {study.held_out.scores["model"]["accuracy"]}
    columns = {"value": [0.3, 0.6], "score": [0.5, 0.99], "difference": [0.49, 0.0]}
    columns |= {"low": [0.2, 0.0], "high": [0.7, 0.0], "is_ruled_out": [True, False]}
    profile = pd.DataFrame({"parameter": "sigma1", **columns})
    panels = profile_figure(trials, document, "", profile).axes
    names = list(document["settings"]["searched"])
    assert [ax.get_xlabel() for ax in panels] == names
    at = names.index("sigma1")
    [line] = [each for each in panels[at].lines if "searched again" in str(each.get_label())]
    assert np.asarray(line.get_ydata()).tolist() == [0.5, 0.99]
    assert panels[at].get_ylim()[1] > 0.99
    band = panels[at].collections[0].get_paths()[0].get_extents()
    assert (band.ymin, band.ymax) == pytest.approx((0.99 - 0.7, 0.99))
    assert not panels[at - 1].collections


def test_a_pareto_front_is_printed_and_drawn(tmp_path: Path) -> None:
    """Against a plain loop; the table has the best in each objective and at most ten rows."""
    objectives = ["accuracy", "false_switches_per_minute"]
    keys = {"recording": {"simulate": "quickstart", "frames": [0, 400]}}
    fit = {"objective": objectives, "trials": 60, "sampler": "random"}
    drives = open_input(simulated(fit=fit, **keys)).drives()
    found = run_study(drives, "tune", [], work=Work(tmp_path))
    values = found.trials[objectives].to_numpy() * [1, -1]
    beaten = [any((a >= b).all() and (a > b).any() for a in values) for b in values]
    front = pareto_front(found.trials, objectives)
    assert set(front["number"]) == set(np.flatnonzero(~np.array(beaten)))
    assert found.trials.loc[front["number"].iloc[0], "accuracy"] == values[:, 0].max()
    rows = found.to_text().split("Pareto front")[1].split("\n\n")[1].splitlines()[2:]
    assert 2 <= len(rows) <= 10
    assert f"{-values[:, 1].max():.3f}" in "".join(rows)
    files = draw_study(tmp_path, style="svg")
    assert [file.name for file in files] == ["history.svg", "profile.svg", "front.svg"]
    document, trials = read_trials(tmp_path)
    [ax] = front_figure(trials, document, "").axes
    assert np.asarray(ax.lines[1].get_xdata()).tolist() == front["accuracy"].tolist()
    for axis, name in zip((ax.get_xlim(), ax.get_ylim()), objectives, strict=True):
        assert front[name].between(*axis).all()


@pytest.mark.parametrize(
    ("low", "out", "words"),
    [
        ([0.0, 0.0, 0.0], [False] * 3, "any value"),
        ([None] * 3, [False] * 3, "unknown: too few frames"),
        ([0.1, 0.0, 0.1], [True, False, True], "0.200 to 0.200"),
        ([0.0, 0.0, 0.1], [False, False, True], "at most 0.200"),
        ([0.1, 0.0, 0.0], [True, False, False], "at least 0.200"),
    ],
)
def test_a_profile_is_printed_in_words(low: list[Any], out: list[bool], words: str) -> None:
    columns = {"value": [0.1, 0.2, 0.3], "difference": [1.0, 0.0, 1.0], "low": low}
    profile = pd.DataFrame({"parameter": "p1", **columns, "is_ruled_out": out})
    assert profile_table(profile, pd.DataFrame()).rows == [["p1", "0.200", words]]


def test_a_directory_without_a_search_is_refused(tmp_path: Path, study: Study) -> None:
    with pytest.raises(InputError, match="is not the directory of a search"):
        draw_study(tmp_path)
    assert study.directory is not None
    content = (study.directory / "study.json").read_text()
    (tmp_path / "study.json").write_text(content)
    study.trials.assign(state="FAIL").to_parquet(tmp_path / "trials.parquet")
    with pytest.raises(InputError, match="has no complete trial"):
        draw_study(tmp_path)
