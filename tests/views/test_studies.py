"""The text and the figures of a study show the trials that it keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.runs import open_input
from egolane_pgm.studies.study import Study, block_folds, run_study
from egolane_pgm.types import InputError
from egolane_pgm.views.studies import (
    draw_study,
    history_figure,
    profile_figure,
    read_trials,
)
from tests.kits.drives import simulated


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    recording, fit = {"simulate": "quickstart", "frames": [0, 400]}, {"sampler": "random"}
    drives = open_input(simulated(recording=recording, fit={**fit, "trials": 24})).drives()
    folder = tmp_path_factory.mktemp("study")
    return run_study(drives, "tune", block_folds(drives, 2), directory=folder)


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
    lines = history_figure(trials, document, "").axes[0].lines
    best = next(line for line in lines if str(line.get_label()).startswith("best"))
    np.testing.assert_array_equal(best.get_ydata(), trials["score"].cummax())
    assert study.held_out is not None
    assert set(np.asarray(lines[-1].get_ydata())) == {study.held_out.scores["model"]["accuracy"]}
    panels = profile_figure(trials, document, "").axes
    assert [ax.get_xlabel() for ax in panels] == list(document["settings"]["searched"])


@pytest.mark.parametrize(
    ("score", "delay"), [("delay", {"median_frames": 4}), ("share_missed", {"share_missed": 0.5})]
)
def test_the_held_out_score_of_lane_changes_is_drawn(score: str, delay: dict[str, float]) -> None:
    trials = pd.DataFrame({"number": range(3), "score": [1.0, 2.0, 3.0]})
    held_out = {"model": {"delay": delay}}
    document = {"settings": {"objectives": [score]}, "held_out": held_out}
    line = history_figure(trials, document, "").axes[0].lines[-1]
    assert set(np.asarray(line.get_ydata())) == set(delay.values())


def test_a_directory_without_a_search_is_refused(tmp_path: Path, study: Study) -> None:
    with pytest.raises(InputError, match="is not the directory of a search"):
        draw_study(tmp_path)
    assert study.directory is not None
    content = (study.directory / "study.json").read_text()
    (tmp_path / "study.json").write_text(content)
    study.trials.assign(state="FAIL").to_parquet(tmp_path / "trials.parquet")
    with pytest.raises(InputError, match="has no complete trial"):
        draw_study(tmp_path)
