"""Tables learned from training frames: with labels and without, and from several drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.drives import Drive
from egolane_pgm.graphs.cpds import lane_normals
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import make_evidence
from egolane_pgm.studies.fits import (
    Fitted,
    apply_fit,
    fit_learn,
    fit_tables,
    start_of_learning,
    training_of,
)
from egolane_pgm.studies.study import block_folds, run_study
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
    one = drive()
    lane, crossing = one.true_lane[one.rows], one.is_crossing[one.rows]
    found = learned(one, np.flatnonzero((lane != 4) & ~crossing))
    before = start_of_learning(one.model).compiled.tables["Lane", 1].values
    after = apply_fit(one.model, found).compiled.tables["Lane", 1].values
    np.testing.assert_allclose(after[3], before[3], atol=1e-9)
    assert np.abs(after[:3] - before[:3]).max() > 0.01


def test_tables_of_several_drives_do_not_depend_on_their_order() -> None:
    drives = two_drives()
    train = [np.arange(len(each)) for each in drives]
    found, again = fit_tables(drives, train), fit_tables(drives[::-1], train[::-1])
    for name, values in found.items():
        np.testing.assert_allclose(again[name], values, atol=1e-9)


def test_tables_that_may_have_been_tuned_on_the_frames_are_not_started_from() -> None:
    given = {"parameters": {"sigma1": 0.1, "bonus_value": 5}}
    same, not_tuned = (drive(tuned_on=each, **given) for each in ("same_frames", "not_tuned"))
    sigma1 = next(p.default for p in same.model.graph.PARAMETERS if p.name == "sigma1")
    start = start_of_learning(same.model).compiled.tables["Lane", 1].values
    np.testing.assert_array_equal(start, lane_normals(sigma1, 4))
    assert start_of_learning(not_tuned.model).compiled.tables["Lane", 1].values[0, 0] > 0.999


def test_frames_that_the_graph_does_not_allow_are_left_out_and_counted(tmp_path: Path) -> None:
    one = drive(tuned_on="not_tuned", parameters={"sigma1": 1e-9})
    with pytest.warns(UserWarning, match=r"sensor_failure does not allow \d+ frame\(s\) to learn"):
        learned(one)
    nothing = "return Evidence({'DetectorOutput': np.zeros((len(log), n_lanes))})"
    with pytest.raises(InputError, match="graph lane_only allows no frame of the 100 to learn"):
        learned(with_rule(tmp_path, nothing))


# --- studies -------------------------------------------------------------------------------------


@pytest.mark.parametrize("labels", [True, False])
def test_a_learned_experiment_is_run_from_its_files(tmp_path: Path, labels: bool) -> None:
    one = drive_of(load_experiment(write_drive(tmp_path, 600, fit={"labels": labels})))
    out = tmp_path / "out"
    study = run_study([one], "learn", block_folds([one], 3), directory=out)
    content = yaml.safe_load((out / "best.yaml").read_text())
    assert (content["graph"], content["tuned_on"]) == ("./best.graph.yaml", "same_frames")
    # The learned graph has no parameters; those of the rule stay.
    assert "sigma1" not in content["parameters"]
    assert "bonus_value" in content["parameters"]
    again = run(out / "best.yaml")
    np.testing.assert_allclose(again.node("Lane"), study.in_sample.node("Lane"), atol=1e-9)
    assert again.run["tuned_on"] == "same_frames"
    ours, theirs = study.model.compiled, again.model.compiled
    np.testing.assert_allclose(theirs.transition, ours.transition, rtol=1e-9)


def test_a_learned_graph_has_its_origin(tmp_path: Path) -> None:
    run_study([drive()], "learn", [], directory=tmp_path / "out")
    graph = tmp_path / "out" / "best.graph.yaml"
    assert run(simulated(), graph=graph).run["tuned_on"] == "same_frames"
    other = simulated(recording=quickstart(3))
    assert run(other, graph=graph).run["tuned_on"] == "other_frames"


def test_without_ground_truth_the_evidence_alone_is_learned_from(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 300, ground_truth=None)
    with pytest.raises(InputError, match="ground_truth: is missing, learning needs it"):
        run_study([drive_of(load_experiment(path))], "learn", [])
    one = drive_of(load_experiment(path, {"fit.labels": False}))
    study = run_study([one], "learn", block_folds([one]))
    assert study.held_out is not None
    assert len(study.held_out) == len(short_drive(300).log)
    assert "model" not in study.held_out.scores
