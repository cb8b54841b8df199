"""One experiment end to end, through the API that the README shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm import running as run_many
from egolane_pgm.drive import check_sources, load_recording
from egolane_pgm.evidence.counting import evidence as counting
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.model import make_evidence, prepare_model, with_parameters
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import Result, is_result, read_result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion
from egolane_pgm.types import InputError
from tests.kits.drives import (
    N_FRAMES,
    command,
    done,
    refused,
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


def test_a_run_gives_what_plain_numpy_gives(drive: Experiment) -> None:
    for choice in ("assumed_density", "exact"):
        run = run_experiment(changed(drive, filter=choice))
        model = run.model
        seen = reference_counting.evidence(run.lines, model.n_lanes, model.parameters)
        right = reference.filter_beliefs(model.compiled, seen, choice)
        np.testing.assert_allclose(run.beliefs.lane, right.lane, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.beliefs.log_evidence, right.log_evidence, atol=1e-12)


def test_hard_evidence_says_only_the_most_probable_value(drive: Experiment) -> None:
    run = run_experiment(changed(drive, evidence_reading="hard"))
    soft = run_experiment(drive)
    assert soft.tentative is not None
    for node, values in run.evidence.likelihoods.items():
        best = soft.evidence.likelihoods[node].max(axis=1, keepdims=True)
        is_best = soft.evidence.likelihoods[node] >= best * (1 - 1e-9)
        np.testing.assert_array_equal(values, is_best)
    model = prepare_model(drive)
    right = filter_beliefs(model.compiled, read_evidence(soft.evidence, "hard"), "assumed_density")
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
    right = filter_beliefs(
        model.compiled, counting(log, 3, model.parameters).take(index), "assumed_density"
    )
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
    np.testing.assert_allclose(other.lines.time_s, one.lines.time_s / 2)
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
    right = filter_beliefs(model.compiled, counting(some, 3, model.parameters), "assumed_density")
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)


def test_crossing_frames_are_filtered_but_not_scored(drive: Experiment) -> None:
    run = run_experiment(drive)
    truth = run.truth
    assert truth is not None
    n_crossing = int(truth.is_crossing.sum())
    assert 0 < n_crossing < N_FRAMES
    assert len(run.beliefs) == N_FRAMES
    for scores in (run.scores["model"], run.scores["detector"]):
        assert np.sum(scores["confusion"]) == scores["frames_scored"] == N_FRAMES - n_crossing
    assigned = assigned_lane(run.beliefs.lane)[~truth.is_crossing]
    right = (assigned == truth.lane[~truth.is_crossing]).mean()
    assert run.scores["model"]["accuracy"] == pytest.approx(right)


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
    assert one.run["data"] == []
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
    assert np.nanmax(run.lines.lri) == 4
    assert not [note for note in run.notes if "LRI" in note]


@pytest.mark.parametrize("graph", ["sensor_failure", "no_wor"])
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
    one = filter_beliefs(quick.compiled, evidence, "assumed_density")
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


def test_a_result_is_kept_where_its_figures_cannot_be_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_experiment(load_experiment(write_drive(tmp_path)))

    def draw(_: Result, file: Path) -> None:
        file.parent.mkdir()
        (file.parent / "half.png").touch()
        raise InputError(f"{file}: cannot be written: disk full")

    monkeypatch.setattr("egolane_pgm.views.strips.draw_strips", draw)
    out = tmp_path / "out"
    with pytest.raises(InputError) as caught:
        run.save(out)
    assert str(caught.value) == (
        f"{out}/figures/strips.png: cannot be written: disk full; the result without figures"
        f" is in {out}"
    )
    assert is_result(out)
    assert not (out / "figures").exists()


@pytest.fixture
def experiments(tmp_path):
    """Three simulated drives and one whose recording is not there."""
    recordings = {f"drive{k}": {"simulate": "quickstart", "seed": k} for k in range(3)}
    recordings["gone"] = {"path": "gone.bag"}
    return [
        str(
            write_experiment(
                tmp_path / f"{name}.yaml",
                name=name,
                recording=recordings[name],
                ground_truth=None,
            )
        )
        for name in ("drive0", "gone", "drive1", "drive2")
    ]


def tasks(experiments, folder):
    sources = [(path, lambda path=path: load_experiment(path)) for path in experiments]
    return run_many.plan_runs(sources, folder)


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_run_has_its_own_result_and_one_that_fails_stops_no_other(experiments, tmp_path, jobs):
    out = tmp_path / "out"
    found = command(
        "run", *experiments, "--jobs", jobs, "--no-figures", "--out", out, "--json", out / "a.json"
    )
    assert found.exit_code == 1
    assert "failed: gone: " in found.output
    assert "gone.bag: no such file" in found.output
    assert "results: 3 of 4" in found.output
    several = ("--recording", "a", "--recording", "b", "--ground-truth", "c")
    said = refused("run", experiments[0], *several)
    assert "--recording: several go with one experiment" in said
    assert [is_result(out / f"drive{k}") for k in range(3)] == [True] * 3
    document = json.loads((out / "a.json").read_text())
    assert [run["name"] for run in document["runs"]] == ["drive0", "drive1", "drive2"]
    assert [entry["experiment"] for entry in document["failed"]] == ["gone"]


def test_several_processes_give_what_one_gives(experiments, tmp_path):
    one, two = (
        list(run_many.run_all(tasks(experiments, tmp_path / str(jobs)), jobs=jobs))
        for jobs in (1, 2)
    )
    assert [o.scores for o in one] == [o.scores for o in two]


def test_two_runs_of_one_name_are_refused_before_anything_is_run(experiments, tmp_path):
    out = tmp_path / "out"
    other = tmp_path / "other.yaml"
    other.write_text(Path(experiments[0]).read_text())
    found = command("run", experiments[0], other, "--out", out)
    assert found.exit_code == 2
    assert "give one of them another `name`" in found.output
    assert not out.exists()


def test_what_nobody_foresaw_in_one_run_is_listed_by_its_kind(experiments, tmp_path):
    def breaks(experiment, **options):
        raise ZeroDivisionError("no lanes\nat all")

    (outcome,) = run_many.run_all(tasks(experiments[:1], tmp_path / "out"), breaks)
    assert outcome.error == "ZeroDivisionError: no lanes at all"


def test_a_smoothed_run_is_the_smoother_and_says_that_it_is_not_causal(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path)
    ran = done(
        *("run", experiment, "--set", "filter=smoothed", "--no-figures"),
        *("--out", tmp_path / "out", "--json", tmp_path / "out.json"),
    )
    assert "smoothed: not causal, a frame's belief uses all later frames too" in ran.stdout
    result = read_result(tmp_path / "out")
    assert result.run["is_causal"] is False
    assert result.scores["is_causal"] is False
    assert json.loads((tmp_path / "out.json").read_text())["is_causal"] is False
    run = run_experiment(load_experiment(experiment))
    right = smooth_beliefs(run.model.compiled, run.evidence)
    np.testing.assert_allclose(result.marginals["Lane"], right.lane, rtol=0, atol=1e-12)
    assert np.abs(result.marginals["Lane"] - run.beliefs.lane).max() > 0.01
    again = tmp_path / "out" / "experiment.yaml"
    assert load_experiment(again).filter == "smoothed"


def test_a_fixed_lag_run_waits_so_many_frames(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, filter="fixed_lag", lag=4)
    ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "fixed_lag: not causal, a frame's belief uses the next 4 frames too" in ran.stdout
    run = run_experiment(experiment)
    right = fixed_lag_beliefs(run.model.compiled, run.evidence, 4)
    np.testing.assert_array_equal(run.beliefs.lane, right.lane)
    plain = reference.fixed_lag_beliefs(run.model.compiled, run.evidence, 4)
    np.testing.assert_allclose(plain.lane, right.lane, rtol=0, atol=1e-10)
    assert load_experiment(tmp_path / "out" / "experiment.yaml").lag == 4


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ("filter=smothed", "filter: 'smothed' is not one of assumed_density, exact, smoothed"),
        (
            "filter=fixed_lag",
            "lag: filter fixed_lag needs a number of frames to wait, e.g. lag: 10",
        ),
        ("start_lane=5", "start_lane: the road has lanes 1 (leftmost) to 3 (got 5)"),
        ("start_lane=[1,0]", "start_lane: needs a lane, or a number for each of the 3 lanes"),
        ("start_lane=[0,0,0]", "start_lane: the lanes' probabilities are not negative, and"),
        ("lag=3", "lag: only filter fixed_lag waits, filter assumed_density has no lag (got 3)"),
        ("filter=fixed_lag lag=-1", "lag: input should be greater than or equal to 0 (got -1)"),
        ("filter=smoothed decode=viterbi unassigned_below=0.5", "a path has a lane"),
        ("decode=viterbi", "decode: viterbi knows the whole drive"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(tmp_path: Path, changes: str, said: str) -> None:
    experiment = write_drive(tmp_path, 20)
    options = [word for change in changes.split() for word in ("--set", change)]
    assert said in refused("run", experiment, *options)


def test_a_decoded_run_answers_the_most_probable_path_beside_the_smoothed_belief(
    tmp_path: Path,
) -> None:
    experiment = write_drive(tmp_path, filter="smoothed", decode="viterbi")
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    run = run_experiment(experiment)
    path = viterbi(run.model.compiled, run.evidence)
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.assigned_lane, path.lane)
    smoothed = smooth_beliefs(run.model.compiled, run.evidence)
    np.testing.assert_allclose(result.marginals["Lane"], smoothed.lane, rtol=0, atol=1e-12)
    truth, rows = run.truth, run.scored
    assert truth is not None
    counts = confusion(path.lane[rows], truth.lane, truth.is_crossing, run.model.n_lanes)
    assert result.scores["model"]["confusion"] == counts.tolist()
    assert load_experiment(tmp_path / "out" / "experiment.yaml").decode == "viterbi"


def test_a_path_that_the_smoothed_belief_doubts_for_long_is_noted(tmp_path: Path) -> None:
    """A detector that says nothing: the likeliest story holds one lane, all stories leave it."""
    experiment = write_drive(
        tmp_path,
        filter="smoothed",
        decode="viterbi",
        graph="lane_only",
        parameters={"sigma1": 0.8, "tentative_noise": 1e9},
    )
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "decode: viterbi is for `egolane run`" in refused("compare", experiment)
    [note] = read_result(tmp_path / "out").run["warnings"]
    assert "the most probable path holds a Lane that the smoothed belief gives less" in note
