"""The verbs as functions, and the objects that they return."""

from __future__ import annotations

import ast
import base64
import copy
import io
import json
import pickle
import pydoc
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import IPython.core.formatters
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import egolane_pgm as ego
from tests.kits.drives import contents, write_drive, write_experiment

SHORT = {"recording.frames": [0, 300]}
QUICKSTART = ego.experiments_folder() / "quickstart.yaml"


@pytest.fixture(scope="module")
def run(drive: Path) -> ego.Result:
    return ego.run(drive)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> ego.Result:
    """A run whose notes have letters of HTML in them."""
    folder = tmp_path_factory.mktemp("a<b>&c")
    write_drive(folder, ground_truth=None)
    found = ego.run(folder / "experiment.yaml")
    run = {**found.run, "warnings": ["<script>alert(1)</script>"]}
    return replace(found, run=run)


# --- what is public ------------------------------------------------------------------------------


def test_the_public_names_are_those_that_dir_and_help_show() -> None:
    assert set(dir(ego)) == {*ego.__all__, "__version__"}
    shown = pydoc.render_doc(ego, renderer=pydoc.plaintext)
    for name in set(ego.__all__) - {"cpds"}:  # a module
        assert f"class {name}(" in shown or f"\n    {name}(" in shown, name
    assert "Filter a recording, score it" in shown


def test_editors_and_type_checkers_see_the_public_names_too() -> None:
    (block,) = (
        node
        for node in ast.parse(Path(str(ego.__file__)).read_text()).body
        if isinstance(node, ast.If)
    )
    seen = {
        name.asname: getattr(import_module(str(node.module)), name.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert seen == {name: getattr(ego, name) for name in ego.__all__}


# --- run -----------------------------------------------------------------------------------------


def test_the_frame_of_a_run_has_a_column_per_value_and_what_there_is_besides(
    run: ego.Result,
) -> None:
    frame = run.to_pandas()
    assert list(frame.index) == list(run.frame_id)
    beliefs = frame[["Lane=1", "Lane=2", "Lane=3"]].to_numpy()
    np.testing.assert_array_equal(beliefs, run.beliefs.lane)
    np.testing.assert_allclose(frame[["SensorState=OK", "SensorState=BAD"]].sum(axis=1), 1)
    np.testing.assert_array_equal(frame["assigned_lane"], run.assigned_lane)
    assert {"time_s", "detector=1", "detector_lane", "log_evidence", "is_impossible"} <= {*frame}
    scored = frame[~frame["is_crossing"]]
    accuracy = float((scored["assigned_lane"] == scored["true_lane"]).mean())
    assert accuracy == pytest.approx(run.scores["model"]["accuracy"])


def test_a_representation_is_one_line_that_says_how_much_the_scores_are_worth(
    run: ego.Result, drive: Path
) -> None:
    assert repr(run) == (
        f"Result('drive': 150 frames, accuracy {run.scores['model']['accuracy']:.3f},"
        f" detector {run.scores['detector']['accuracy']:.3f}; not tuned, causal)"
    )
    tuned = ego.run(drive, overrides={"tuned_on": "same_frames", "filter": "smoothed"})
    assert repr(tuned).endswith("; in-sample, not causal (filter))")
    blind = ego.run(drive, overrides={"ground_truth": None})
    assert repr(blind) == "Result('drive': 150 frames, no ground truth; not tuned, causal)"


def test_a_table_for_a_notebook_escapes_what_it_is_given(
    run: ego.Result, hostile: ego.Result
) -> None:
    shown = run._repr_html_()
    assert "<th>detector</th><th>model</th>" in shown
    assert f"<td>{run.scores['model']['accuracy']:.3f}</td>" in shown
    assert "<script>" not in hostile._repr_html_()
    assert "&lt;script&gt;" in hostile._repr_html_()


def test_pyplot_knows_no_figure_that_was_plotted(run: ego.Result) -> None:
    before = pyplot.get_fignums()
    figure = run.plot(20, 60)
    assert pyplot.get_fignums() == before
    figure.savefig(io.BytesIO(), format="png")
    assert "frames 20 to 60" in figure.texts[0].get_text()
    with pytest.raises(ego.InputError, match="the range 900 to 901 has no frames"):
        run.plot(900, 901)


def test_a_notebook_draws_a_figure_though_nobody_used_pyplot(
    run: ego.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    formatter = IPython.core.formatters.DisplayFormatter()
    monkeypatch.setattr(IPython, "get_ipython", lambda: MagicMock(display_formatter=formatter))
    data, _ = formatter.format(run.plot())
    assert base64.b64decode(data["image/png"]).startswith(b"\x89PNG")
    data, _ = formatter.format(run)
    assert data == {"text/plain": repr(run), "text/html": run._repr_html_()}


def test_a_saved_run_is_read_back_as_the_same_object(run: ego.Result, tmp_path: Path) -> None:
    again = ego.load_result(run.save(tmp_path / "run", figures=False))
    assert type(again) is type(run)
    assert repr(again) == repr(run)
    assert again.to_pandas().equals(run.to_pandas())
    assert again.scores == run.scores
    assert again.evidence is None
    np.testing.assert_array_equal(again.model.compiled.transition, run.model.compiled.transition)
    copy = again.save(tmp_path / "copy", figures=False)
    assert contents(copy) == contents(tmp_path / "run")


# --- several runs --------------------------------------------------------------------------------


def test_several_runs_are_found_by_name_saved_and_read_together(
    drive: Path, tmp_path: Path
) -> None:
    other = ego.load_experiment(drive, {"name": "hard", "evidence_reading": "hard"})
    runs = ego.run([drive, other])
    assert repr(runs) == "DriveTable('drive', 'hard')"
    assert runs["hard"].experiment == other
    assert [each.name for each in runs] == ["drive", "hard"]
    found = runs.to_pandas()["model.accuracy"]
    assert found["hard"] == runs["hard"].scores["model"]["accuracy"]
    assert isinstance(runs.plot(), Figure)
    assert "<th>hard</th>" in runs._repr_html_()
    with pytest.raises(ego.InputError, match="drive: 'soft' is not one of drive, hard"):
        runs["soft"]
    saved = ego.load_result(runs.save(tmp_path / "several", figures=False))
    assert repr(saved) == repr(runs)
    assert saved.to_pandas().equals(runs.to_pandas())


def test_one_run_that_fails_does_not_stop_the_others(drive: Path, tmp_path: Path) -> None:
    bad = write_experiment(tmp_path / "bad.yaml", name="bad", recording={"path": "none.csv"})
    with pytest.warns(UserWarning, match=r"bad: .*none\.csv"):
        runs = ego.run([bad, drive])
    assert [each.name for each in runs] == ["drive"]
    assert runs.failed[0][0] == "bad"
    assert "failed: bad" in runs._repr_html_()
    with pytest.raises(ego.InputError, match=r"none\.csv"):
        ego.run([bad])


# --- learn ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def learned() -> ego.Result:
    experiment = ego.load_experiment(QUICKSTART, SHORT)
    return ego.learn(experiment, overrides={"learning.labels": False}, blocks=2)


def test_the_frames_that_were_held_out_can_be_looked_at_and_saved(
    learned: ego.Result, tmp_path: Path
) -> None:
    frame = learned.to_pandas()
    scored = frame[~frame["is_crossing"]]
    accuracy = float((scored["assigned_lane"] == scored["true_lane"]).mean())
    assert accuracy == pytest.approx(learned.scores["model"]["accuracy"])
    assert list(frame["block"].unique()) == [0, 1]
    assert isinstance(learned.plot(), Figure)
    assert repr(learned).endswith("; held out, causal)")
    assert "<td>" in learned._repr_html_()
    again = ego.load_result(learned.save(tmp_path / "out", figures=False))
    assert repr(again) == repr(pickle.loads(pickle.dumps(learned))) == repr(learned)
    assert again.to_pandas().equals(frame)
    assert "log evidence per frame" in again.to_text()


# --- tune ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tuned() -> ego.Study:
    return ego.tune(QUICKSTART, trials=25, sampler="random")


def test_a_search_gives_its_trials_and_an_experiment_with_the_best(tuned: ego.Study) -> None:
    frame = tuned.to_pandas()
    assert frame.index.names == ["study", "number"]
    assert len(frame) == 25
    best = frame["accuracy_in_sample"].max()
    (experiment,) = tuned.experiments.values()
    assert ego.run(experiment).scores["model"]["accuracy"] == pytest.approx(best)
    assert repr(tuned).startswith(f"Study('quickstart': 25 trials, accuracy {best:.3f} in-sample")
    assert "held out" in repr(tuned)
    assert "<table>" in tuned._repr_html_()


def test_a_saved_study_is_read_back(tuned: ego.Study, tmp_path: Path) -> None:
    saved = tuned.save(tmp_path / "study", figures=False)
    again = ego.load_result(saved)
    assert repr(again) == repr(tuned)
    assert again.to_pandas().equals(tuned.to_pandas())
    assert repr(pickle.loads(pickle.dumps(tuned))) == repr(tuned)
    tuned.save(tmp_path / "study", figures=False)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x").write_text("x")
    with pytest.raises(ego.InputError, match="is not a result directory"):
        tuned.save(tmp_path / "other")


def test_several_studies_are_found_by_name_and_go_on_where_they_were(tmp_path: Path) -> None:
    one = ego.load_experiment(QUICKSTART, SHORT)
    other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    how: dict[str, Any] = {
        "sampler": "random",
        "in_sample_only": True,
        "out": tmp_path,
        "figures": False,
    }
    first = ego.tune([one, other], trials=2, **how)
    assert first.names == ["quickstart", "exact"]
    with pytest.raises(ego.InputError, match="there are 2 studies, take one"):
        first.best  # noqa: B018
    assert "p1" in first["exact"].best
    more = ego.tune([one, other], trials=3, **how)
    trials = more.to_pandas()
    assert trials.groupby("study").size().to_dict() == {"exact": 3, "quickstart": 3}
    before = first.to_pandas().sort_index()
    assert trials.sort_index().loc[before.index].equals(before)
    assert repr(ego.load_result(tmp_path)) == "Study('exact', 'quickstart')"


# --- reading -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nothing", "is not there"),
        ("empty", "is not a result directory of run, tune or compare"),
        ("file", "is not a result directory"),
    ],
)
def test_a_directory_that_is_no_result_is_refused_by_name(
    tmp_path: Path, name: str, said: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(ego.InputError, match=f"{name}: {said}"):
        ego.load_result(tmp_path / name)


# --- reproduce ----------------------------------------------------------------------------------


def test_a_run_of_the_paper_is_repeated_beside_its_table(recordings: Path, tmp_path: Path) -> None:
    found = ego.reproduce(runs=3, out=tmp_path)
    assert found.document["total_frames_off"] == 0
    frame = found.to_pandas()
    assert frame.loc["run03_italy_mc", "model.accuracy"] == pytest.approx(0.843, abs=0.001)
    assert isinstance(found.plot(), Figure)
    assert repr(ego.load_result(tmp_path / "run03_italy_mc")) == repr(found["run03_italy_mc"])
    assert "<th>3</th>" in found._repr_html_()


@pytest.mark.parametrize(
    ("verb", "given", "said"),
    [
        (
            ego.run,
            {"experiment": QUICKSTART, "recording": 3, "n_lanes": 4},
            "recording: 3 is neither a file nor a DataFrame",
        ),
        (ego.run, {"experiment": QUICKSTART, "camera": 3}, "camera: 3 is not the name of a file"),
        (ego.run, {"experiment": QUICKSTART, "overrides": {"filtr": 3}}, "unknown key 'filtr'"),
        (ego.run, {"experiment": 3}, "3 is no experiment; give the path of a YAML file"),
        (ego.run, {"experiment": None}, "run: name an experiment, or a recording of lines"),
        (ego.run, {"experiment": "nowhere.yaml"}, "nowhere.yaml: cannot be read"),
        (ego.run, {"experiment": {"n_lanes": 3, "recording": {"path": "x"}}}, "name: is missing"),
        (ego.learn, {"experiment": [QUICKSTART]}, "experiment: takes one; fleet takes a table"),
        (ego.reproduce, {"runs": 11}, "run 11: the paper has runs 1 to 10"),
        (ego.reproduce, {"runs": ["one"]}, "'one' is no number"),
        (ego.tune, {"experiments": 3}, "3 is no experiment"),
        (ego.tune, {"experiments": QUICKSTART, "parameter": ["p1=1"]}, "parameter: .* is no dict"),
        (ego.tune, {}, "name experiments, or runs of the paper"),
        (ego.detect, {"pictures": 3, "camera": "x.yaml"}, "pictures: 3 is not the name of a file"),
        (ego.detect, {"pictures": "x", "camera": "x", "parameters": ["a"]}, "parameters: .* no di"),
    ],
)
def test_an_argument_that_does_not_fit_is_said_in_one_line(
    verb: Any, given: dict[str, Any], said: str
) -> None:
    with pytest.raises(ego.InputError, match=said) as caught:
        verb(**given)
    assert "\n" not in str(caught.value)


# --- compare -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compared() -> ego.Comparison:
    one = ego.load_experiment(QUICKSTART, SHORT)
    two = {"name": "learned", "fit": "learn", "learning": {"labels": False}}
    return ego.compare([one, ego.load_experiment(one, two)], blocks=2)


def test_a_comparison_has_a_row_for_each_recording_experiment_and_score(
    compared: ego.Comparison,
) -> None:
    frame = compared.to_pandas()
    assert frame.index.names == ["recording", "experiment", "subset", "score"]
    assert compared.names == ["quickstart", "learned"]
    (entry, other) = compared.document["recordings"][0]["experiments"]
    at = ("quickstart, seed 0", "quickstart", "all_frames")
    assert frame.loc[(*at, "accuracy"), "value"] == entry["scores"]["all_frames"]["accuracy"]
    assert frame.loc[(*at, "delay_share_missed"), "value"] >= 0
    assert frame.loc[(*at, "accuracy"), "tuned_on"] == "not_tuned"
    assert frame["tuned_on"].xs("learned", level="experiment").unique() == [other["tuned_on"]]
    assert not frame.index.duplicated().any()
    assert isinstance(compared.plot(), Figure)
    assert isinstance(compared.plot("differences"), Figure)
    with pytest.raises(ego.InputError, match="figure: 'f1' is not one of accuracy, differences"):
        compared.plot("f1")
    assert repr(compared) == (
        "Comparison(quickstart, learned on quickstart, seed 0;"
        " not tuned, causal or held out, causal)"
    )
    assert "<td>" in compared._repr_html_()


def test_a_saved_comparison_is_read_back(compared: ego.Comparison, tmp_path: Path) -> None:
    saved = compared.save(tmp_path / "ours")
    assert (saved / "figures" / "accuracy.png").is_file()
    again = ego.load_result(saved)
    assert repr(again) == repr(compared)
    assert again.to_pandas().equals(compared.to_pandas())
    assert repr(pickle.loads(pickle.dumps(compared))) == repr(compared)
    assert len(again["quickstart, seed 0", "learned"]) == 300
    with pytest.raises(ego.InputError, match="is not here; there are quickstart, seed 0"):
        compared["quickstart", "learned"]
    runs = ego.load_result(saved / "quickstart_seed_0")
    assert runs.names == ["learned", "quickstart"]


def test_graphs_on_a_run_of_the_paper_are_in_sample(recordings: Path) -> None:
    found = ego.compare(graphs=["sensor_failure", "lane_only"], runs="3")
    assert repr(found).endswith("on run 3; in-sample, causal or not tuned, causal)")
    assert found.names == ["sensor_failure", "lane_only", "detector"]
    assert isinstance(found.plot(), Figure)


def test_a_damaged_comparison_is_refused(compared: ego.Comparison, tmp_path: Path) -> None:
    saved = compared.save(tmp_path / "ours", figures=False)
    file = saved / "comparison.json"
    whole = json.loads(file.read_text())
    for damage, said in (
        (lambda c: c.clear(), "recordings"),
        (lambda c: c.update(schema_version=99), "schema_version 99, this program reads 1"),
    ):
        content = copy.deepcopy(whole)
        damage(content)
        file.write_text(json.dumps(content))
        with pytest.raises(ego.InputError, match=rf"comparison\.json.*{said}.*compare again"):
            ego.load_result(saved)
