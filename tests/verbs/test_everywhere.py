"""Networks, modules, results, studies and lines in memory in every verb: an answer or one line."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.result import as_result
from tests.kits.drives import log_with_gaps, short_drive, write_drive

#: Keys of a model whose tables can be learned, and its lanes.
COUNTING = {"evidence": "counting", "graph": "sensor_failure", "filter": "assumed_density"}
TRUTH = short_drive().truth
NO_EVIDENCE = ego.Evidence({"DetectorOutput": np.ones((9, 3)), "WOR": np.ones((9, 2))})


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One of each kind."""
    drive = write_drive(tmp_path_factory.mktemp("drive"))
    log = short_drive().log
    options: dict[str, Any] = {"n_lanes": 3, "ground_truth": TRUTH, "overrides": COUNTING}
    study = ego.learn(drive, folds=2)
    return {
        "experiment": ego.load_experiment(drive),
        "result": ego.run(drive),
        "result in memory": ego.run(log, **options),
        "study": study,
        "study in memory": ego.learn(log, folds=2, **options),
        "exploration": ego.explore(drive, edge=["Lane -> WOR"], overrides={"fit.folds": 2}),
        "network": study.model.network,
        "module": import_module("egolane_pgm.graphs.wor_on_lane"),
        "lines": log,
        "frame": log.to_pandas(),
        "frames": [log.to_pandas(), log_with_gaps()],
        "results": [ego.run(drive), ego.run(drive, overrides={"filter": "exact"})],
    }


VERBS: dict[str, Any] = {
    "run": ego.run,
    "tune": lambda given, **more: ego.tune(given, trials=2, folds=0, **more),
    "learn": lambda given, **more: ego.learn(given, folds=0, **more),
    "explore": lambda given, **more: ego.explore(given, edge=["Lane -> WOR"], judge="bic", **more),
}
WITH_MODEL = {"result", "result in memory", "study", "study in memory", "exploration"}
ON_RESULTS = {"result", "result in memory", "study", "study in memory"}
ON_MODELS: dict[str, Any] = {
    "check": lambda given: ego.check(given, n=20),
    "draw_network": ego.draw_network,
    "sample": lambda given: ego.sample(given, 9, seed=0),
    "predicted": lambda given: ego.predicted(given, NO_EVIDENCE),
    "compare": ego.compare,
    "draw_tables": ego.draw_tables,
    "filter_beliefs": lambda given: ego.filter_beliefs(given, NO_EVIDENCE),
    "smooth_beliefs": lambda given: ego.smooth_beliefs(given, NO_EVIDENCE),
    "fixed_lag_beliefs": lambda given: ego.fixed_lag_beliefs(given, NO_EVIDENCE, 2),
    "viterbi": lambda given: ego.viterbi(given, NO_EVIDENCE),
    "posterior_paths": lambda given: ego.posterior_paths(given, NO_EVIDENCE, 2, seed=0),
    "expected_counts": lambda given: ego.expected_counts(given, NO_EVIDENCE),
    "unrolled": lambda given: ego.unrolled(given, NO_EVIDENCE, 0, 1),
    "fit_tables": lambda given: ego.fit_tables(given, NO_EVIDENCE, iterations=1),
}


def answer(verb: Any, *given: Any, **more: Any) -> str:
    """The type of what a verb returns; an InputError must be one line."""
    try:
        return type(verb(*given, **more)).__name__
    except ego.InputError as error:
        return "refused" if len(str(error).splitlines()) == 1 else str(error)


KINDS = (
    *("experiment", "result", "result in memory", "study", "study in memory", "exploration"),
    *("network", "module", "lines", "frame", "frames", "results"),
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_takes_it_or_refuses_it_in_one_line(
    things: dict[str, Any], verb: str, kind: str
) -> None:
    """As what is run or fitted, and as the graph."""
    more: dict[str, Any] = {}
    if kind in ("lines", "frame", "frames"):
        more = {"n_lanes": 3, "overrides": COUNTING, "ground_truth": TRUTH}
    returned = answer(VERBS[verb], things[kind], **more)
    is_taken = kind not in ("network", "module", "exploration")
    is_taken &= verb != "run" or kind not in ("frames", "results")
    names = {"run": "Result", "explore": "Exploration"}
    assert returned == (names.get(verb, "Study") if is_taken else "refused")
    as_graph = answer(VERBS[verb], things["experiment"], graph=things[kind])
    is_graph = kind in WITH_MODEL | {"network", "module"}
    assert as_graph == (names.get(verb, "Study") if is_graph else "refused")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", ON_MODELS)
def test_a_model_is_found_in_it_or_refused_in_one_line(
    things: dict[str, Any], verb: str, kind: str
) -> None:
    returned = answer(ON_MODELS[verb], things[kind])
    taken = ON_RESULTS if verb in ("check", "compare") else {*WITH_MODEL, "network"}
    assert (returned != "refused") == (kind in taken)


def test_a_study_is_compared_by_its_held_out_result(things: dict[str, Any], tmp_path: Path) -> None:
    study, result = things["study"], things["result"]
    saved = replace(result, run={**result.run, "name": "saved"}).save(tmp_path / "saved")
    found = ego.compare([study, result, saved])
    assert found.index.to_list() == ["drive_learned", "drive", "saved"]
    assert found["tuned_on"].to_list() == ["other_frames", "not_tuned", "not_tuned"]
    assert found["accuracy"].iloc[0] == study.held_out.scores["model"]["accuracy"]
    alone = ego.compare(ego.learn(things["experiment"], folds=0))
    assert alone["tuned_on"].to_list() == ["same_frames"]


# --- lines in memory -----------------------------------------------------------------------------


def test_lines_in_memory_are_fitted_as_their_file_is(things: dict[str, Any]) -> None:
    ours, theirs = things["study in memory"], things["study"]
    assert ours.fitted == theirs.fitted
    assert ours.held_out.scores == theirs.held_out.scores


def test_several_drives_in_memory_have_a_ground_truth_each() -> None:
    logs, truths = [short_drive().log, log_with_gaps()], [TRUTH, TRUTH.iloc[::2]]
    more: dict[str, Any] = {"n_lanes": 3, "overrides": COUNTING, "folds": 0}
    study = ego.learn(logs, ground_truth=truths, **more)
    scored = study.in_sample.frames.groupby("drive", sort=False)["true_lane"].count()
    assert scored.to_list() == [150, int((~truths[1].index.isin([20, 22, 60])).sum())]
    with pytest.raises(ego.InputError, match="ground_truth: a list of 1 for 2 experiments"):
        ego.learn(logs, ground_truth=truths[:1], **more)
    with pytest.raises(ego.InputError, match="ground_truth: is missing, learning needs it"):
        ego.learn(logs, **more)


def test_clips_in_memory_stay_apart() -> None:
    log = replace(short_drive().log, clip=np.repeat(["a", "b"], 75))
    once = ego.run(log, n_lanes=3, overrides=COUNTING)
    again = ego.run(once)
    pd.testing.assert_frame_equal(again.frames, once.frames)
    assert set(again.frames["drive"]) == {"a", "b"}


# --- what the model was fitted to ----------------------------------------------------------------


def test_what_was_fitted_to_these_frames_is_in_sample_in_every_form(
    things: dict[str, Any], tmp_path: Path
) -> None:
    experiment, study = things["experiment"], things["study"]
    assert as_result(study, "").model is study.model
    study.save(tmp_path / "learned")
    ego.explore(
        experiment, edge=["Lane -> WOR"], overrides={"fit.folds": 2}, out=tmp_path / "explored"
    )
    explored, graph = (tmp_path / name / "best.graph.yaml" for name in ("explored", "learned"))
    forms: list[Any] = [study, study.in_sample, study.model, study.model.network, graph]
    forms += [explored, things["exploration"]]
    for form in forms:
        assert ego.run(experiment, graph=form).run["tuned_on"] == "same_frames", form
    assert ego.run(study).run["tuned_on"] == "same_frames"
    assert ego.run(things["study in memory"]).run["tuned_on"] == "same_frames"
    by_key = ego.run(experiment, overrides={"graph": str(graph)})
    assert by_key.run["tuned_on"] == "same_frames"
    [trained] = by_key.model.learned_from
    assert trained.frames == ((0, 150),)
    other = ego.load_experiment("quickstart", {"recording.frames": [0, 60]}, n_lanes=3)
    for form in forms:
        assert ego.run(other, graph=form).run["tuned_on"] == "other_drive", form


def test_what_may_have_been_fitted_to_these_frames_is_unknown(
    things: dict[str, Any], tmp_path: Path
) -> None:
    experiment = things["experiment"]
    unmarked = things["result"].model.network
    ego.explore(experiment, edge=["Lane -> WOR"], judge="bic", out=tmp_path)
    for form in (unmarked, things["result"], tmp_path / "best.bif"):
        assert ego.run(experiment, graph=form).run["tuned_on"] == "unknown"
    two = ego.learn([experiment, write_drive(tmp_path / "other")], folds=0)
    assert ego.run(experiment, graph=two).run["tuned_on"] == "same_frames"
    with pytest.raises(ego.InputError, match="a study of several recordings can be a graph only"):
        ego.run(two)
    assert ego.compare([two, things["study"]])["recordings"].to_list() == [2]
