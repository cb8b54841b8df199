"""Tables learned from training frames: with labels and without, and from several drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import egolane_pgm as ego
from egolane_pgm.drives import Drive
from egolane_pgm.graphs.cpds import lane_normals
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import make_evidence
from egolane_pgm.scoring.confusion import log_loss_per_frame
from egolane_pgm.studies.fits import (
    Fitted,
    apply_fit,
    fit_graph,
    fit_learn,
    start_of_learning,
    training_of,
)
from egolane_pgm.studies.study import Work, block_folds, run_study
from egolane_pgm.types import InputError
from tests.conftest import needs_compiler
from tests.kits.drives import run, short_drive, simulated, write_drive
from tests.kits.studies import drive_of, quickstart, scrambled, two_drives

pytestmark = needs_compiler

ROOT = Path(__file__).parents[2]


def drive(**keys: Any) -> Drive:
    return drive_of(simulated(**keys))


def learned(one: Drive, train: Any = None) -> Fitted:
    """The fit to some training frames; the labels of the others are masked, as in a study."""
    train = np.arange(len(one)) if train is None else np.asarray(train)
    return fit_learn([one.mask_labels(train)], [train], None)


# --- what is learned from ------------------------------------------------------------------------


@pytest.mark.parametrize("labels", [True, False])
def test_the_training_frames_alone_are_used(labels: bool) -> None:
    """Neither the labels nor the lines of the other frames, nor the labels of crossing ones."""
    one = drive(fit={"labels": labels})
    train = np.arange(600)
    others = np.union1d(np.arange(600, len(one)), np.flatnonzero(one.is_crossing[one.rows]))
    changed = scrambled(one, others)
    offset = one.log.offset_m.copy()
    offset[one.rows[600:]] *= -1
    changed = replace(changed, log=replace(one.log, offset_m=offset))
    found = learned(one, train)
    assert learned(changed, train) == found
    assert learned(one) != found
    is_same = learned(scrambled(one, train), train) == found
    assert is_same is not labels


def test_frames_between_two_training_frames_are_used_others_are_not() -> None:
    """Annotated are frames 1, 2, 5, 6 and 7 of nine."""
    whole = drive()
    log = whole.log.take(slice(0, 9))
    lane = np.where(np.isin(np.arange(9), [1, 2, 5, 6, 7]), 2, 0)
    one = replace(whole, log=log, true_lane=lane, is_crossing=np.zeros(9, dtype=bool))
    everything = make_evidence(one.model, log)[0]
    for train, frames in (
        ([0, 1, 2], [0, 1, 2, 3, 4, 5]),
        ([0, 4], [0, 1, 7, 8]),
        # One neighbour alone is not enough: 3 and 4 lie between 2 and 5.
        ([0, 1], [0, 1, 2]),
        ([2, 3, 4], [5, 6, 7, 8]),
    ):
        evidence, _, is_first = training_of(one, np.array(train), labels=True)
        for node, values in evidence.likelihoods.items():
            np.testing.assert_array_equal(values, everything.likelihoods[node][frames])
        begins = np.flatnonzero(np.diff(frames, prepend=-2) > 1)
        assert np.flatnonzero(is_first).tolist() == begins.tolist()


RULE = """
import numpy as np
from egolane_pgm.types import Evidence
PARAMETERS, PROVIDES = (), ('DetectorOutput',)
def evidence(log, n_lanes, parameters):
    {body}
"""


def with_rule(folder: Path, body: str, **changes: Any) -> Drive:
    (folder / "rule.py").write_text(RULE.format(body=body))
    keys = {"evidence": "./rule.py", "graph": "lane_only", **changes}
    return drive_of(load_experiment(write_drive(folder, 100, **keys)))


def test_a_rule_that_looks_back_has_the_frames_before_the_training_frames(tmp_path: Path) -> None:
    """This one gives lane 1 in the first ten frames of its log, then lane 3."""
    body = (
        "says = np.where(np.arange(len(log)) < 10, 0, 2);"
        " return Evidence({'DetectorOutput': np.eye(n_lanes)[says] + 1e-3})"
    )
    one = with_rule(tmp_path, body, fit={"labels": False})
    first = np.asarray(learned(one, np.arange(40, 100))["tables.Lane.first"])
    assert first[2] > first[0]


# --- what is learned -----------------------------------------------------------------------------


def test_a_lane_without_a_label_keeps_its_start() -> None:
    one = drive(fit={"objective": "log_evidence"})
    lane, crossing = one.true_lane[one.rows], one.is_crossing[one.rows]
    found = learned(one, np.flatnonzero((lane != 4) & ~crossing))
    before = start_of_learning(one.model).compiled.tables["Lane", 1].values
    after = apply_fit(one.model, found).compiled.tables["Lane", 1].values
    np.testing.assert_allclose(after[3], before[3], atol=1e-9)
    assert np.abs(after[:3] - before[:3]).max() > 0.01


def test_with_labels_the_filter_s_log_loss_is_minimised() -> None:
    """Eight numbers of a graph with an input, two sequences; every fifth frame is labelled."""
    made = run(simulated())
    lines = made.lines["a"].to_pandas()
    lines["Lines"] = lines.groupby("frame_id")["is_valid"].transform("sum")
    truth = made.frames[["true_lane", "is_crossing"]][::5].reset_index()
    graph = str(ROOT / "examples" / "lines_graph.py")
    keys = {"fit.learns": "parameters", "fit.block": 1}
    given: Any = {"graph": graph, "ground_truth": truth, "n_lanes": 4, "folds": 0}
    losses = []
    for changes in ({}, {"fit.objective": "log_evidence"}):
        more = {**keys, **changes, "fit.untrusted_frames": [[400, 800]]}
        study = ego.learn(lines, overrides=more, **given)
        frames = study.in_sample.frames
        frames = frames[(frames["true_lane"] > 0) & ~frames["is_crossing"] & frames["is_trusted"]]
        belief = frames.filter(regex="^Lane_").to_numpy()
        losses.append(log_loss_per_frame(belief, frames["true_lane"]).mean())
        assert len(study.fitted) == 8
    assert losses[0] < losses[1]
    assert study.settings["objective"] == "log_evidence"
    # Numbers of tables that an input selects are fitted as well.
    assert abs(float(str(study.fitted["many"])) - 0.99) > 1e-3


def test_tables_of_several_drives_do_not_depend_on_their_order() -> None:
    drives = two_drives()
    train = [np.arange(len(each)) for each in drives]
    found, again = fit_graph(drives, train), fit_graph(drives[::-1], train[::-1])
    for name, values in found.items():
        np.testing.assert_allclose(again[name], values, atol=1e-9)


def test_tables_that_may_have_been_tuned_on_the_frames_are_not_started_from() -> None:
    given = {"parameters": {"sigma1": 0.1, "bonus_value": 5}}
    same, not_tuned = (drive(tuned_on=each, **given) for each in ("same_frames", "not_tuned"))
    sigma1 = next(p.default for p in same.model.graph.parameters if p.name == "sigma1")
    start = start_of_learning(same.model).compiled.tables["Lane", 1].values
    np.testing.assert_array_equal(start, lane_normals(sigma1, 4))
    assert start_of_learning(not_tuned.model).compiled.tables["Lane", 1].values[0, 0] > 0.999


def test_frames_that_the_graph_does_not_allow_are_left_out_and_counted(tmp_path: Path) -> None:
    by_em = {"objective": "log_evidence"}
    one = drive(tuned_on="not_tuned", parameters={"sigma1": 1e-9}, fit=by_em)
    with pytest.warns(UserWarning, match=r"sensor_failure does not allow \d+ frame\(s\) to learn"):
        learned(one)
    nothing = "return Evidence({'DetectorOutput': np.zeros((len(log), n_lanes))})"
    with pytest.raises(InputError, match="graph lane_only allows no frame of the 100 to learn"):
        learned(with_rule(tmp_path, nothing, fit=by_em))


# --- parameters of the graph, and several starts -------------------------------------------------

NAMES = ("sigma1", "sigma2", "p1", "p2", "p3", "p4")
NO_LABELS = {"fit.labels": False, "tuned_on": "not_tuned"}


@pytest.mark.parametrize(
    ("run", "right"), [("01", [0.329, 0.998, 0.956]), ("08", [0.307, 0.996, 0.979])]
)
def test_parameters_of_the_paper_by_maximum_likelihood(
    recordings: Path, run: str, right: Any
) -> None:
    [path] = (ROOT / "experiments" / "paper").glob(f"run{run}*")
    found = learned(drive_of(load_experiment(path, {**NO_LABELS, "fit.learns": "parameters"})))
    assert [found[name] for name in ("sigma1", "p1", "p2")] == pytest.approx(right, abs=0.002)
    # A normal distribution this narrow stays in its lane.
    assert found["sigma2"] < 0.2
    assert [found["p3"], found["p4"]] == pytest.approx([1, 1], abs=1e-3)


def test_several_starts_leave_a_local_optimum(recordings: Path) -> None:
    [path] = (ROOT / "experiments" / "paper").glob("run08*")
    changes = {**NO_LABELS, "fit.strength": 1e-6, "filter": "exact"}
    evidence = []
    for trials in (1, 4):
        one = drive_of(load_experiment(path, {**changes, "fit.trials": trials}))
        found = apply_fit(one.model, learned(one))
        evidence.append(
            filter_beliefs(found.compiled, make_evidence(found, one.log)[0]).log_evidence.mean()
        )
    assert evidence[1] > evidence[0] + 0.1


def test_learned_parameters_have_bounds_and_are_run_from_their_file(tmp_path: Path) -> None:
    fit = {
        "learns": "parameters",
        "parameters": {"p1": 0.7, "sigma1": [0.2, 0.3], "bonus_value": 2},
    }
    keys = {"fit": {**fit, "trials": 2}, "parameters": {"sigma1": 0.25}}
    one = drive_of(load_experiment(write_drive(tmp_path, 300, **keys)))
    study = run_study([one], "learn", block_folds([one], 2), work=Work(tmp_path / "out"))
    assert set(study.fitted) == {*NAMES, "bonus_value"}
    assert (study.fitted["p1"], study.fitted["bonus_value"]) == (0.7, 2)
    assert 0.2 <= float(str(study.fitted["sigma1"])) <= 0.3
    assert (study.posterior["low"] <= study.posterior["high"]).all()
    again = run(tmp_path / "out" / "best.yaml")
    np.testing.assert_allclose(again.node("Lane"), study.in_sample.node("Lane"), atol=1e-12)


def test_a_graph_in_pgmpy_has_parameters_to_learn(tmp_path: Path) -> None:
    (tmp_path / "g.py").write_text(
        "from egolane_pgm.graphs import lane_only\n"
        "from egolane_pgm.inference.compile import compile_tables\n"
        "PARAMETERS, HIDDEN, OBSERVED, UNUSED = (\n"
        "    lane_only.PARAMETERS, lane_only.HIDDEN, lane_only.OBSERVED, ('WOR',))\n"
        "def build(n, p):\n"
        "    tables = lane_only.tables(n, p)\n"
        "    return compile_tables(tables, hidden=HIDDEN, observed=OBSERVED).network\n"
    )
    changes = {"fit.learns": "parameters", "fit.parameters": {"sigma1": [0.1, 0.9]}}
    found = []
    for graph in (str(tmp_path / "g.py"), "lane_only"):
        path = write_drive(tmp_path, 200, graph=graph)
        found.append(learned(drive_of(load_experiment(path, changes))))
    assert found[0] == pytest.approx(found[1], rel=1e-3)


REFUSED = {
    "fit.learns: evidence rule counting has no fit": {"learns": "rule"},
    "fit.strength: unknown key 'Lan' .did you mean 'Lane'": {"strength": {"Lan": 3}},
    "fit.strength: needs a number greater than 0": {"strength": {"Lane": 0}},
    "fit.block: .*greater than or equal to 1": {"block": 0},
    "fit.objective: learning fits log_loss or log_evidence, not f1": {"objective": "f1"},
    "fit.objective: log_loss needs labels, and fit.labels is false": {
        "objective": "log_loss",
        "labels": False,
    },
    "parameters.sigma1: 0.4 is outside of .0.5, 1. .fit.parameters": {
        "parameters": {"sigma1": [0.5, 1]}
    },
    "fit.strength: needs a number greater than 0, at": {"strength": "much"},
    "fit.parameters.bonus_value: changes the evidence": {"parameters": {"bonus_value": [0, 3]}},
    "fit.parameters: every parameter is fixed": {
        "parameters": dict.fromkeys(("sigma1", "sigma2", "p1", "p2", "p3", "p4"), 0.5)
    },
}


@pytest.mark.parametrize("message", REFUSED)
def test_settings_of_learning_that_do_not_fit_are_refused(message: str) -> None:
    fit = {"learns": "parameters"} if "parameters" in message else {}
    with pytest.raises(InputError, match=message):
        run_study([drive(tuned_on="not_tuned", fit={**fit, **REFUSED[message]})], "learn", [])


# --- studies -------------------------------------------------------------------------------------


@pytest.mark.parametrize("labels", [True, False])
def test_a_learned_experiment_is_run_from_its_files(tmp_path: Path, labels: bool) -> None:
    one = drive_of(load_experiment(write_drive(tmp_path, 600, fit={"labels": labels})))
    out = tmp_path / "out"
    study = run_study([one], "learn", block_folds([one], 3), work=Work(out))
    content = yaml.safe_load((out / "best.yaml").read_text())
    assert content["graph"] == "./best.graph.yaml"
    assert [each["frames"] for each in content["tuned_on"]] == [[[0, 600]]]
    # The learned graph has no parameters; those of the rule stay.
    assert "sigma1" not in content["parameters"]
    assert "bonus_value" in content["parameters"]
    again = run(out / "best.yaml")
    np.testing.assert_allclose(again.node("Lane"), study.in_sample.node("Lane"), atol=1e-9)
    assert again.run["tuned_on"] == "same_frames"
    ours, theirs = study.model.compiled, again.model.compiled
    np.testing.assert_allclose(theirs.transition, ours.transition, rtol=1e-9)


def test_a_learned_graph_has_its_origin(tmp_path: Path) -> None:
    run_study([drive()], "learn", [], work=Work(tmp_path / "out"))
    graph = tmp_path / "out" / "best.graph.yaml"
    assert run(simulated(), graph=graph).run["tuned_on"] == "same_frames"
    other = simulated(recording=quickstart(3))
    assert run(other, graph=graph).run["tuned_on"] == "other_drive"


def test_without_ground_truth_the_evidence_alone_is_learned_from(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 300, ground_truth=None)
    with pytest.raises(InputError, match="ground_truth: is missing, learning needs it"):
        run_study([drive_of(load_experiment(path))], "learn", [])
    one = drive_of(load_experiment(path, {"fit.labels": False}))
    study = run_study([one], "learn", block_folds([one]))
    assert study.held_out is not None
    assert len(study.held_out) == len(short_drive(300).log)
    assert "model" not in study.held_out.scores
