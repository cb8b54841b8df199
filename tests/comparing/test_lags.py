"""Accuracy over delay: each lag is scored as a fixed-lag run is, and tables and figure show it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import egolane_pgm as ego
from egolane_pgm.comparing.compared import Asked, document
from egolane_pgm.comparing.lags import check_lags, lagged_beliefs, whole_frames
from egolane_pgm.comparing.planning import by_recording, compare_groups
from egolane_pgm.drive import load_drive
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.smoothing import fixed_lag_beliefs
from egolane_pgm.learning import with_found
from egolane_pgm.model import make_evidence
from egolane_pgm.running import run_experiment
from egolane_pgm.types import InputError
from egolane_pgm.views.comparison_figures import STUDY, _height, lags_figure
from egolane_pgm.views.comparison_tables import lag_rows
from tests.conftest import needs_compiler
from tests.kits.drives import command, done, geometry, refused, simulated, write_drive

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

LAGS = (0.0, 0.5, 2.0)


def compared(*experiments: Experiment, **options: Any) -> dict[str, Any]:
    return document(compare_groups(by_recording(experiments), Asked(lags=LAGS), **options))


def entries(found: dict[str, Any]) -> list[dict[str, Any]]:
    return [entry for recording in found["recordings"] for entry in recording["experiments"]]


@pytest.mark.parametrize("make", [simulated, geometry])
def test_each_lag_is_scored_as_a_run_with_that_lag(make: Any) -> None:
    (entry,) = entries(compared(make(tuned_on="not_tuned")))
    found = entry["lags"]["all_frames"]
    assert (found["lag_s"], found["frames"]) == ([0.0, 0.5, 2.0], [0, 5, 20])
    assert len(set(found["accuracy"])) > 1
    for k, frames in enumerate(found["frames"]):
        run = run_experiment(make(tuned_on="not_tuned", filter="fixed_lag", lag=frames))
        right = run.scores["model"]
        for name in ("accuracy", "f1"):
            assert found[name][k] == right[name]
            assert found["intervals"][name][k] == right["intervals"][name]
        assert found["log_loss"][k] == pytest.approx(right["log_loss"], abs=1e-9)


def test_lag_zero_is_the_exact_filter_and_a_lag_as_long_as_the_drive_its_smoother() -> None:
    result = ego.run(geometry(tuned_on="not_tuned"), held_out=True)
    # The smoother has defaults of its own.
    same = {"alpha": 0.035, "lane_width_m": "causal", "line_sigma_per_m": 0.03}
    alike = {"parameters": {"cells": 4, "motion_bins": 9, **same}}
    runs = [run_experiment(geometry(filter=name, **alike)) for name in ("exact", "smoothed")]
    right = [run.beliefs.lane for run in runs]
    for found, lane in zip(lagged_beliefs(result, (0.0, 1e4)), right, strict=True):
        np.testing.assert_allclose(found, lane, rtol=0, atol=1e-9)


def test_a_block_waits_with_what_was_learned_without_it() -> None:
    result = ego.run(geometry(fit="learn"), held_out=True, blocks=3)
    drive = load_drive(result.experiment, needs_truth=None)
    parameters = result.run["parameters_per_block"]
    assert len(set(map(repr, parameters))) == 3
    (lane,) = lagged_beliefs(result, (1.0,))
    for b, found in enumerate(parameters):
        model = with_found(drive.model, found, drive.experiment)
        evidence = make_evidence(model, drive.recorded.log).filtered
        right = fixed_lag_beliefs(model.compiled, evidence, 10).lane[drive.rows]
        mine = result.block == b
        np.testing.assert_allclose(lane[mine], right[mine], rtol=0, atol=1e-9)


def test_the_evidence_is_made_once_for_all_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    result = ego.run(geometry(tuned_on="not_tuned"), held_out=True)
    calls = []
    real = make_evidence
    monkeypatch.setattr("egolane_pgm.drive.make_evidence", lambda *a: calls.append(a) or real(*a))
    assert len(lagged_beliefs(result, [0, 0.3, 1, 4])) == 4
    assert len(calls) == 1


def test_untrusted_labels_are_left_out_and_without_lags_nothing_is_told() -> None:
    tuning = {"never_fit": {"from_frame": 900}}
    (entry,) = entries(compared(simulated("a", tuning=tuning)))
    every, trusted = entry["lags"]["all_frames"], entry["lags"]["without_never_fit"]
    assert every["accuracy"] != trusted["accuracy"]
    found = document(compare_groups(by_recording([simulated()])))
    assert entries(found)[0]["lags"] is None
    with pytest.raises(InputError, match="no lags to draw"):
        lags_figure(found)


def test_seeds_of_a_search_are_averaged() -> None:
    tuned = simulated(fit="tune", tuning={"trials": 2})
    found = entries(compared(tuned, seeds=(1, 2), n_blocks=2))[0]["lags"]["all_frames"]
    each = [
        entries(compared(tuned, seeds=(seed,), n_blocks=2))[0]["lags"]["all_frames"]["accuracy"]
        for seed in (1, 2)
    ]
    assert found["accuracy"] == pytest.approx(np.mean(each, axis=0).tolist())
    assert found["intervals"] is None


@given(st.integers(0, 10_000), st.sampled_from([1.0, 10.0, 12.5, 25.0, 29.97, 30.0, 100.0]))
def test_a_time_holds_the_frames_that_come_within_it(frames: int, rate: float) -> None:
    assert whole_frames(frames / rate, rate) == frames
    assert whole_frames((frames + 0.9) / rate, rate) == frames


def test_a_time_that_is_no_whole_number_of_frames_and_gaps_are_said(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    rows = [r.split(",") for r in (tmp_path / "lines.csv").read_text().splitlines()]
    kept = [r for r in rows if not (r[0].isdecimal() and 50 <= int(r[0]) < 60)]
    (tmp_path / "lines.csv").write_text("\n".join(map(",".join, kept)) + "\n")
    said = command("compare", path, "--lags", "0.84,0.04,1,0").stderr
    assert (
        "lags: 0.84 s is no whole number of frames at 10 a second; the belief waits for 8, 0.8 s"
    ) in said
    assert "lags: 0.04 s is no whole number of frames" in said
    assert "lags: 1 s" not in said
    assert "lags: frame ids jump 1 times" in said


@pytest.mark.parametrize("given", [["x"], "0,x", [None], [np.nan], [0, np.inf], {"a": 1}])
def test_what_is_no_time_is_refused(given: Any) -> None:
    with pytest.raises(InputError, match=r"^lags: .* no numbers of seconds, as 0, 0.5, 1 are$"):
        check_lags(given)


def test_times_are_sorted_and_each_once_and_none_is_negative() -> None:
    assert check_lags(np.array([2, 0, 2])) == (0.0, 2.0)
    assert check_lags(1) == (1.0,)
    assert check_lags([]) == ()
    with pytest.raises(InputError, match=r"^lags: -0.5 s must not be negative$"):
        check_lags([1, -0.5])


def test_the_command_shows_writes_and_draws_the_lags(tmp_path: Path) -> None:
    path, out, target = write_drive(tmp_path), tmp_path / "out", tmp_path / "x.json"
    words = ("compare", path, "--lags", "0,1", "--json", target)
    shown = done(*words, "--out", out).stdout.splitlines()
    entry = json.loads(target.read_text())["recordings"][0]["experiments"][0]
    cells = [f"{value:.4f}" for value in entry["lags"]["all_frames"]["accuracy"]]
    assert shown[0].split() == ["|", "accuracy", "|", "0", "s", "|", "1", "s", "|"]
    assert shown[2].split() == ["|", "lines", "|", cells[0], "|", cells[1], "|"]
    assert "causal: drive" in shown
    assert max(map(len, shown)) <= 100
    assert (out / "figures" / "lags.png").read_bytes().startswith(b"\x89PNG")
    csv = done(*words, "--format", "csv").stdout.splitlines()
    assert csv == ["accuracy,0 s,1 s", ",".join(["lines", *cells])]


def test_what_has_no_lags_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "a")
    assert refused("compare", path, "--lags", "0,x").startswith("--lags: ['0', 'x'] are no")
    assert refused("compare", path, "--lags=-1") == "--lags: -1 s must not be negative"
    bare = write_drive(tmp_path / "bare", ground_truth=None)
    assert "ground_truth: is missing" in refused("compare", bare, "--lags", "1")


def test_the_function_has_the_table_and_the_figure(tmp_path: Path) -> None:
    experiments = [simulated("a", tuned_on="same_frames"), geometry("b", tuned_on="not_tuned")]
    found = ego.compare(experiments, blocks=2, lags=np.array([0, 1]))
    frame = found.to_pandas("lags")
    assert frame.index.names == ["recording", "experiment", "subset", "lag_s"]
    _, second = found.document["recordings"][0]["experiments"]
    lags = second["lags"]["all_frames"]
    row = frame.loc[("quickstart, seed 0", "b", "all_frames", 1.0)]
    assert (row["frames"], row["accuracy"]) == (10, lags["accuracy"][1])
    assert [row["low"], row["high"]] == lags["intervals"]["accuracy"][1]
    assert not frame.index.duplicated().any()
    assert found.to_xarray("lags")["accuracy"].shape == (1, 2, 1, 2)
    (left, right) = found.plot("lags").axes
    assert [ax.get_title("left") for ax in (left, right)] == ["a", "b"]
    assert f"{lags['accuracy'][1]:.4f}" in found._repr_html_()
    header, rows = lag_rows(found.document)
    assert header == ["accuracy", "experiment", "0 s", "1 s"]
    assert [row[1] for row in rows] == ["a", "b"]
    assert [row[2].endswith("*") for row in rows] == [True, False]
    again = ego.load_result(found.save(tmp_path / "kept"))
    assert again.to_pandas("lags").equals(frame)
    assert (tmp_path / "kept" / "figures" / "lags.png").is_file()
    none = ego.compare(experiments[0], blocks=2)
    for ask in (lambda: none.to_pandas("lags"), lambda: none.plot("lags")):
        with pytest.raises(InputError, match="lags"):
            ask()
    with pytest.raises(InputError, match=r"table: 'lag' is not one of scores, lags \(did you"):
        found.to_pandas("lag")


def test_the_figure_has_a_curve_for_each_recording_their_mean_and_the_other_study() -> None:
    def part(title: str, accuracy: list[float]) -> dict[str, Any]:
        found = {"lag_s": [0, 1], "accuracy": accuracy}
        entry = {"name": "a", "tuned_on": "not_tuned", "lags": {"all_frames": found}}
        return {"title": title, "experiments": [entry]}

    curves = {f"run {k}": [0.9, 0.9 + 0.005 * k] for k in range(1, 11)}
    found = {"recordings": [part(title, values) for title, values in curves.items()]}
    figure = lags_figure(found)
    (ax,) = figure.axes
    lines = {line.get_label(): line for line in ax.lines}
    mean = np.mean(list(curves.values()), axis=0).tolist()
    for label, values in {**curves, "mean of 10": mean}.items():
        np.testing.assert_allclose(lines[label].get_ydata(), [_height(v) for v in values])
    (star,) = (line for line in ax.lines if line.get_marker() == "*")
    assert (star.get_xdata()[0], star.get_ydata()[0]) == (STUDY[0], _height(STUDY[1]))
    assert "arXiv:2405.17270" in figure.texts[-1].get_text()
    looks = [(line.get_color(), line.get_marker(), line.get_linestyle()) for line in ax.lines]
    assert len(set(looks)) == len(looks)
    assert lag_rows(found)[1][-1] == ["mean of 10", "0.9000", f"{mean[1]:.4f}"]
