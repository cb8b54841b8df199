"""One experiment end to end, through the API that the README shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm import load_experiment, run_experiment
from egolane_pgm.evidence.counting import evidence as counting
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence
from egolane_pgm.loading import check_sources, load_recording
from egolane_pgm.model import make_evidence, prepare_model, with_parameters
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import is_result, read_result
from egolane_pgm.run import save_run, summary
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import InputError
from tests.kits.drives import (
    N_FRAMES,
    done,
    short_drive,
    write_drive,
    write_experiment,
)
from tests.reference import counting as reference_counting
from tests.reference import inference as reference

#: Frames that the recording below lacks; none of them first or last.
GAPS = (20, 21, 22, 60)


def with_gaps(folder: Path, **changes: Any) -> Experiment:
    """The drive without the frames of GAPS."""
    path = write_drive(folder, **changes)
    log = short_drive().log
    write_table(folder / "lines.csv", log.take(~np.isin(log.frame_id, GAPS)))
    return load_experiment(path)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return load_experiment(write_drive(tmp_path_factory.mktemp("drive")))


def changed(experiment: Experiment, **changes: Any) -> Experiment:
    return experiment.model_copy(update=changes)


def test_the_belief_is_the_filters_on_the_rules_evidence(drive: Experiment) -> None:
    run = run_experiment(drive)
    model, log = prepare_model(drive), short_drive().log
    given = counting(log, 3, model.parameters)
    beliefs = filter_beliefs(model.compiled, given, "assumed_density")
    np.testing.assert_array_equal(run.beliefs.lane, beliefs.lane)
    np.testing.assert_array_equal(run.beliefs.frame_id, log.frame_id)
    assert run.tentative is not None
    np.testing.assert_allclose(run.tentative, given.likelihoods["DetectorOutput"], atol=1e-15)
    np.testing.assert_allclose(run.beliefs.lane.sum(axis=1), 1)


def test_an_experiment_may_be_given_as_its_file(drive: Experiment) -> None:
    one, other = run_experiment(drive.source), run_experiment(drive)
    np.testing.assert_array_equal(one.beliefs.lane, other.beliefs.lane)


def test_a_run_gives_what_plain_numpy_gives(drive: Experiment) -> None:
    for choice in ("assumed_density", "exact"):
        run = run_experiment(changed(drive, filter=choice))
        model = run.model
        seen = reference_counting.evidence(run.recorded.log, model.n_lanes, model.parameters)
        right = reference.filter_beliefs(model.compiled, seen, choice)
        np.testing.assert_allclose(run.beliefs.lane, right.lane, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.beliefs.log_evidence, right.log_evidence, atol=1e-12)


def test_the_exact_filter_is_run_on_request(drive: Experiment) -> None:
    experiment = changed(drive, filter="exact")
    run, model = run_experiment(experiment), prepare_model(experiment)
    exact = filter_beliefs(model.compiled, run.evidence, "exact")
    np.testing.assert_array_equal(run.beliefs.lane, exact.lane)
    assert np.abs(run.beliefs.lane - run_experiment(drive).beliefs.lane).max() > 1e-3


def test_hard_evidence_says_only_the_most_probable_value(drive: Experiment) -> None:
    run = run_experiment(changed(drive, evidence_reading="hard"))
    soft = run_experiment(drive)
    assert soft.tentative is not None
    for node, values in run.evidence.likelihoods.items():
        best = soft.evidence.likelihoods[node].max(axis=1, keepdims=True)
        is_best = soft.evidence.likelihoods[node] >= best * (1 - 1e-9)
        np.testing.assert_array_equal(values, is_best)
    model = prepare_model(drive)
    right = filter_beliefs(model.compiled, read_evidence(soft.evidence, "hard"))
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)
    np.testing.assert_array_equal(run.tentative, soft.tentative)  # the detector is as it was
    assert np.abs(run.beliefs.lane - soft.beliefs.lane).max() > 0.01


def test_missing_frames_are_skipped_by_default(tmp_path: Path) -> None:
    run = run_experiment(with_gaps(tmp_path))
    assert len(run.beliefs) == N_FRAMES - len(GAPS)
    assert not set(GAPS) & set(run.beliefs.frame_id.tolist())
    assert run.scores["model"]["frames"] == N_FRAMES - len(GAPS)


def test_missing_frames_are_held_as_if_the_frame_before_came_again(tmp_path: Path) -> None:
    run = run_experiment(with_gaps(tmp_path, recording__missing_frames="hold"))
    log = short_drive().log
    index = np.arange(len(log))
    for gap in GAPS:  # in order, so that each holds what was held before it
        index[log.frame_id == gap] = index[np.flatnonzero(log.frame_id == gap) - 1]
    model = prepare_model(run.experiment)
    right = filter_beliefs(model.compiled, counting(log, 3, model.parameters).take(index))
    np.testing.assert_array_equal(run.beliefs.frame_id, log.frame_id)
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)
    assert run.scores["model"]["frames"] == N_FRAMES


@pytest.mark.parametrize("reading", ["soft", "hard"])
def test_missing_frames_are_predicted_by_the_model_alone(tmp_path: Path, reading: str) -> None:
    experiment = with_gaps(tmp_path, recording__missing_frames="predict", evidence_reading=reading)
    run = run_experiment(experiment)
    assert len(run.beliefs) == N_FRAMES
    parameters = run.model.parameters
    sigma1, p1, p2 = (float(parameters[k]) for k in ("sigma1", "p1", "p2"))
    lanes = np.arange(1, 4)
    f = np.exp(-0.5 * ((lanes[None] - lanes[:, None]) / sigma1) ** 2)
    f /= f.sum(axis=1, keepdims=True)
    sensor = np.array([[p1, 1 - p1], [1 - p2, p2]])
    for t in np.flatnonzero(np.isin(run.beliefs.frame_id, GAPS)):
        before = {node: values[t - 1] for node, values in run.beliefs.marginals.items()}
        np.testing.assert_allclose(run.beliefs.lane[t], before["Lane"] @ f, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            run.beliefs.marginals["SensorState"][t],
            before["SensorState"] @ sensor,
            rtol=0,
            atol=1e-12,
        )
        assert run.beliefs.log_evidence[t] == pytest.approx(0, abs=1e-12)
    skipped = run_experiment(with_gaps(tmp_path, evidence_reading=reading))
    assert np.abs(skipped.beliefs.lane[20] - run.beliefs.lane[23]).max() > 0


def test_the_frame_rate_sets_times_and_what_is_counted_per_minute(drive: Experiment) -> None:
    faster = drive.recording.model_copy(update={"frame_rate": 20.0})
    one, other = run_experiment(drive), run_experiment(changed(drive, recording=faster))
    np.testing.assert_allclose(other.recorded.log.time_s, one.recorded.log.time_s / 2)
    for kind in ("detector", "model"):
        a, b = one.scores[kind], other.scores[kind]
        assert b["false_switches_per_minute"] == pytest.approx(2 * a["false_switches_per_minute"])
        assert b["confusion"] == a["confusion"]
    assert one.scores["detector"]["false_switches_per_minute"] > 0


def test_a_range_of_frames_is_run_as_if_there_were_no_others(drive: Experiment) -> None:
    section = drive.recording.model_copy(update={"frames": (30, 90)})
    run = run_experiment(changed(drive, recording=section))
    np.testing.assert_array_equal(run.beliefs.frame_id, np.arange(30, 90))
    model, log = prepare_model(drive), short_drive().log
    some = log.take((log.frame_id >= 30) & (log.frame_id < 90))
    right = filter_beliefs(model.compiled, counting(some, 3, model.parameters))
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)


def test_crossing_frames_are_filtered_but_not_scored(drive: Experiment) -> None:
    run = run_experiment(drive)
    truth = run.recorded.truth
    assert truth is not None
    n_crossing = int(truth.is_crossing.sum())
    assert 0 < n_crossing < N_FRAMES
    assert len(run.beliefs) == N_FRAMES
    for scores in run.scores.values():
        assert np.sum(scores["confusion"]) == scores["frames_scored"] == N_FRAMES - n_crossing
    assigned = assigned_lane(run.beliefs.lane)[~truth.is_crossing]
    right = (assigned == truth.lane[~truth.is_crossing]).mean()
    assert run.scores["model"]["accuracy"] == pytest.approx(right)


def test_without_ground_truth_there_are_beliefs_and_no_scores(drive: Experiment) -> None:
    run = run_experiment(changed(drive, ground_truth=None))
    assert run.scores == {}
    assert len(run.beliefs) == N_FRAMES
    said = summary(run)
    assert not {"detector", "model"} & set(said)
    assert (said["frames"], said["frames_scored"]) == (N_FRAMES, 0)


def test_a_recording_at_hand_is_not_read_again(drive: Experiment, tmp_path: Path) -> None:
    recorded = load_recording(drive)
    gone = changed(drive, recording=drive.recording.model_copy(update={"path": "gone.csv"}))
    run = run_experiment(gone, recorded=recorded)
    np.testing.assert_array_equal(run.beliefs.lane, run_experiment(drive).beliefs.lane)


def test_a_simulated_drive_brings_its_own_ground_truth(tmp_path: Path) -> None:
    path = write_experiment(
        tmp_path / "e.yaml",
        recording={"simulate": "quickstart", "seed": 5, "frames": [0, 100]},
        ground_truth=None,
    )
    one, other = run_experiment(path), run_experiment(path)
    np.testing.assert_array_equal(one.beliefs.lane, other.beliefs.lane)
    assert one.recorded.files == ()
    assert "accuracy" in one.scores["model"]
    another = run_experiment(load_experiment(path, ["recording.seed=6"]))
    assert (another.beliefs.lane != one.beliefs.lane).any()


def test_a_rule_with_its_own_largest_lri_clips_at_that(tmp_path: Path) -> None:
    (tmp_path / "r.py").write_text(
        "from egolane_pgm.evidence.counting import *\n"
        "from egolane_pgm.evidence import counting\n"
        "from egolane_pgm.parameters import Parameter\n"
        "TENTATIVE = 'DetectorOutput'\n"
        "PARAMETERS = tuple(p for p in counting.PARAMETERS if p.name != 'max_lri') + (\n"
        "    Parameter('max_lri', 'positive', 4, 'x'),)\n"
    )
    path = write_drive(tmp_path, evidence="./r.py", recording__lri="clip")
    run = run_experiment(path)
    assert np.nanmax(short_drive().log.lri) > 4
    assert np.nanmax(run.recorded.log.lri) == 4
    assert not [note for note in run.notes if "LRI" in note]


@pytest.mark.parametrize("graph", ["sensor_failure", "wor_on_lane", "no_wor", "lane_only"])
def test_every_graph_runs_and_new_parameters_are_as_good_as_a_new_model(
    drive: Experiment, graph: str
) -> None:
    experiment = changed(drive, graph=graph)
    model = prepare_model(experiment)
    given = {"sigma1": 0.7, "sigma2": 0.2}
    new = prepare_model(changed(experiment, parameters=given))
    specs = [*model.rule.PARAMETERS, *model.graph.PARAMETERS]
    quick = with_parameters(model, resolve_parameters(specs, given, 3))
    np.testing.assert_array_equal(quick.compiled.transition, new.compiled.transition)
    evidence = make_evidence(model, short_drive().log).filtered
    one = filter_beliefs(quick.compiled, evidence)
    other = run_experiment(changed(experiment, parameters=given)).beliefs
    np.testing.assert_array_equal(one.lane, other.lane)


def test_a_graph_without_tables_takes_new_parameters_by_being_declared_anew(
    drive: Experiment,
) -> None:
    own = Path(__file__).parents[1] / "examples" / "my_graph.py"
    experiment = changed(drive, graph=str(own))
    model = prepare_model(experiment)
    changed_model = with_parameters(model, {**model.parameters, "sigma1": 0.9})
    new = prepare_model(changed(experiment, parameters={"sigma1": 0.9}))
    np.testing.assert_array_equal(changed_model.compiled.transition, new.compiled.transition)
    assert (changed_model.compiled.transition != model.compiled.transition).any()


def test_a_parameter_that_rule_and_graph_declare_differently_is_refused(
    drive: Experiment, tmp_path: Path
) -> None:
    (tmp_path / "g.py").write_text(
        "from egolane_pgm.graphs.sensor_failure import *\n"
        "from egolane_pgm.parameters import Parameter\n"
        "PARAMETERS = PARAMETERS + (Parameter('max_lri', 'integer', 1, 'x'),)\n"
    )
    with pytest.raises(InputError, match=r"parameters\.max_lri: graph and evidence rule declare"):
        prepare_model(changed(drive, graph=str(tmp_path / "g.py")))


def test_sources_are_checked_without_reading_them(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    (tmp_path / "lines.csv").write_text("no table")
    check_sources(load_experiment(path))
    (tmp_path / "ground_truth.txt").unlink()
    with pytest.raises(InputError, match=r"ground_truth\.path: ground_truth\.txt: no such file"):
        check_sources(load_experiment(path))


def test_with_predict_the_papers_model_diffuses_over_missing_frames_too(tmp_path: Path) -> None:
    drive = short_drive(40).log
    kept = np.ones(40, dtype=bool)
    kept[20:25] = False
    path = write_drive(
        tmp_path, 40, filter="exact", graph="lane_only", recording__missing_frames="predict"
    )
    write_table(tmp_path / "lines.csv", drive.take(kept))
    done("run", path, "--no-figures", "--out", tmp_path / "out")
    belief = read_result(tmp_path / "out").marginals["Lane"]
    centres = np.arange(3)
    move = np.exp(-0.5 * ((centres[None] - centres[:, None]) / 0.4) ** 2)
    move /= move.sum(axis=1, keepdims=True)
    for k in range(20, 25):
        np.testing.assert_allclose(belief[k], belief[k - 1] @ move, atol=1e-9)


def test_a_result_is_kept_where_its_figures_cannot_be_drawn(tmp_path: Path) -> None:
    run = run_experiment(load_experiment(write_drive(tmp_path)))

    def draw(folder: Path) -> None:
        (folder / "figures").mkdir()
        (folder / "figures" / "half.png").touch()
        raise InputError(f"{folder / 'figures' / 'a.png'}: cannot be written: disk full")

    out = tmp_path / "out"
    with pytest.raises(InputError) as caught:
        save_run(run, out, draw)
    assert str(caught.value) == (
        f"{out}/figures/a.png: cannot be written: disk full; the result without figures is in {out}"
    )
    assert is_result(out)
    assert not (out / "figures").exists()
