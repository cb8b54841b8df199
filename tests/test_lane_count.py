"""Whether the lines fit the number of lanes that was told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm import paper
from egolane_pgm.drive import Recorded, load_recording
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.labelling import label_experiment
from egolane_pgm.lane_count import (
    ALIKE,
    FEWER,
    MORE,
    doubt_of_lanes,
    motion_by_lanes,
    odds_of,
)
from egolane_pgm.model import Model, make_evidence, prepare_model
from egolane_pgm.running import run_experiment
from egolane_pgm.simulation import simulate
from egolane_pgm.types import Evidence
from tests.conftest import needs_compiler
from tests.kits.drives import write_drive
from tests.kits.strangers import scale_changes

FOLDER = paper.experiments_folder()


@pytest.fixture(scope="module")
def simulated() -> Experiment:
    return load_experiment(FOLDER / "zero_label.yaml")


@pytest.fixture(scope="module")
def recorded(simulated: Experiment) -> Recorded:
    return replace(load_recording(simulated), truth=None)


def with_lanes(experiment: Experiment, n_lanes: int) -> Experiment:
    return load_experiment(experiment, {"n_lanes": n_lanes})


def odds_of_fewer(experiment: Experiment, model: Model, *of_lines: Any) -> float:
    return odds_of(model.n_lanes - 1, experiment, model, *of_lines)


def asked(experiment: Experiment, recorded: Recorded, function: Callable[..., object]) -> object:
    """What a function of experiment, model, log and evidence says."""
    model = prepare_model(experiment)
    evidence = make_evidence(model, recorded.log, experiment.evidence_reading).filtered
    return function(experiment, model, recorded.log, evidence)


def doubt(experiment: Experiment, recorded: Recorded) -> str:
    """The warning, or "None"."""
    return str(asked(experiment, recorded, doubt_of_lanes))


def motion(experiment: Experiment, recorded: Recorded) -> dict[int, float]:
    found = asked(experiment, recorded, lambda e, m, log, evidence: motion_by_lanes(m, evidence))
    assert isinstance(found, dict)
    return found


def test_motion_is_the_evidence_of_a_sensor_that_always_fails(
    simulated: Experiment, recorded: Recorded
) -> None:
    model = prepare_model(simulated)
    evidence = make_evidence(model, recorded.log).filtered
    ((key, likelihood),) = evidence.likelihoods.items()
    cells = likelihood.shape[1] // 3
    of_place = likelihood[:, :cells, 1] / likelihood[:, :cells, 1].max(axis=1, keepdims=True)
    found = motion_by_lanes(model, evidence)
    assert list(found) == [2, 3, 4]
    for n_lanes, log_evidence in found.items():
        tiled = np.repeat(np.tile(of_place, n_lanes)[..., None], 2, axis=2)
        compiled = prepare_model(with_lanes(simulated, n_lanes)).compiled
        beliefs = filter_beliefs(compiled, Evidence({key: tiled}, evidence.inputs), "exact")
        assert log_evidence == pytest.approx(beliefs.log_evidence.sum())


def test_the_lines_are_weighed_as_in_runs_with_that_many_lanes(
    simulated: Experiment, recorded: Recorded
) -> None:
    runs = [run_experiment(with_lanes(simulated, n), recorded=recorded) for n in (2, 3)]
    fewer, told = (run.beliefs.log_evidence.sum() for run in runs)
    assert asked(simulated, recorded, odds_of_fewer) == pytest.approx(fewer - told)


@pytest.mark.parametrize("n_lanes", [2, 3])
def test_a_run_and_labels_warn_once_of_a_number_that_is_wrong_by_one(
    n_lanes: int, simulated: Experiment
) -> None:
    drive = simulate("quickstart", seed=3, n_lanes=n_lanes, frames=6000)
    lines = Recorded(drive.log, None, np.zeros(0, dtype=np.int64), (), ())
    expected = {
        n_lanes - 1: f"the car moves across {n_lanes} lanes or more, n_lanes is {n_lanes - 1} (",
        n_lanes: "",
        n_lanes + 1: f"the lines fit a road of {n_lanes} lanes better, n_lanes is {n_lanes + 1} (",
    }
    for told, words in expected.items():
        experiment = with_lanes(simulated, told)
        runs = [run_experiment(experiment, recorded=lines)]
        if told == 2:
            runs.append(label_experiment(experiment, recorded=lines).run)
        for run in runs:
            found = [note for note in run.notes if "n_lanes" in note]
            assert len(found) == (1 if words else 0)
            assert all(words in note for note in found)


def test_lanes_that_the_car_is_never_in_are_not_doubted(simulated: Experiment) -> None:
    drive = simulate("quickstart", seed=3, n_lanes=5, frames=6000)
    lines = Recorded(drive.log, None, np.zeros(0, dtype=np.int64), (), ())
    right = with_lanes(simulated, 5)
    found = motion(right, lines)
    assert found[4] > found[5] - ALIKE
    assert doubt(right, lines) == "None"


@pytest.mark.parametrize(
    ("preset", "n_lanes", "doubts"),
    [
        ("a4", 4, {3: "is it too small?", 4: "None", 5: "is it too large?"}),
        ("quickstart", 2, {2: "None"}),
    ],
)
def test_a_number_of_lanes_is_doubted_after_hours_as_after_minutes(
    preset: str, n_lanes: int, doubts: dict[int, str], simulated: Experiment
) -> None:
    drive = simulate(preset, seed=0, frames=60_000 if preset == "a4" else 20_000, n_lanes=n_lanes)
    lines = Recorded(drive.log, None, np.zeros(0, dtype=np.int64), (), ())
    found = motion(with_lanes(simulated, n_lanes), lines)
    assert found[n_lanes + 1] > found[n_lanes] + MORE
    for told, words in doubts.items():
        assert doubt(with_lanes(simulated, told), lines).endswith(words)


def test_a_road_of_one_lane_is_no_answer(simulated: Experiment, recorded: Recorded) -> None:
    assert list(motion(with_lanes(simulated, 1), recorded)) == [1, 2]
    assert asked(with_lanes(simulated, 2), recorded, odds_of_fewer) == 0


def test_a_frame_alone_tells_nothing(simulated: Experiment, recorded: Recorded) -> None:
    one = replace(recorded, log=recorded.log.take(slice(0, 1)))
    found = motion(simulated, one)
    assert max(found.values()) - min(found.values()) < ALIKE
    assert asked(simulated, one, odds_of_fewer) < FEWER  # type: ignore[operator]
    assert doubt(simulated, one) == "None"
    none = replace(recorded, log=recorded.log.take(slice(0, 0)))
    assert doubt(simulated, none) == "None"


def test_graphs_that_do_not_follow_the_place_say_nothing(tmp_path: Path) -> None:
    counting = load_experiment(write_drive(tmp_path))
    assert motion(counting, load_recording(counting)) == {}
    assert doubt(counting, load_recording(counting)) == "None"


def test_evidence_that_is_read_as_no_likelihood_says_nothing(
    simulated: Experiment, recorded: Recorded
) -> None:
    hard = load_experiment(simulated, {"evidence_reading": "hard", "n_lanes": 2})
    assert doubt(hard, recorded) == "None"


def test_parameters_of_one_number_of_lanes_fit_no_other(
    simulated: Experiment, recorded: Recorded
) -> None:
    learned = load_experiment(simulated, {"parameters.sigmas_m": [0.2] * 6})
    assert asked(learned, recorded, odds_of_fewer) == 0
    assert list(motion(learned, recorded)) == [2, 3, 4]


@needs_compiler
@pytest.mark.parametrize("run", [1, 8])
def test_the_lines_of_the_paper_s_recordings_tell_how_many_lanes_there_are(
    run: int, simulated: Experiment, recordings: Path
) -> None:
    there = load_experiment(paper.paper_experiment(run))
    n = there.n_lanes
    recorded = replace(load_recording(there), truth=None)
    found = [motion(with_lanes(simulated, told), recorded) for told in (n - 1, n, n + 1)]
    assert found[0][n] - found[0][n - 1] > MORE + 20
    assert found[1][n + 1] - found[1][n] < MORE - 10
    assert found[1][n] - found[1][n - 1] > ALIKE + 20
    assert found[2][n + 1] - found[2][n] < ALIKE
    fewer = asked(with_lanes(simulated, n + 1), recorded, odds_of_fewer)
    assert fewer > FEWER + 5  # type: ignore[operator]


@needs_compiler
@pytest.mark.parametrize("run", [1, 8])
def test_a_change_of_scale_in_the_paper_s_recordings_is_said(
    run: int, simulated: Experiment, recordings: Path
) -> None:
    there = load_experiment(paper.paper_experiment(run))
    model = prepare_model(with_lanes(simulated, there.n_lanes))
    log = load_recording(there).log
    for lines, n_warnings in ((log, 0), (scale_changes(log, 0.6), 1)):
        notes = make_evidence(model, lines).notes
        assert sum("first half" in note for note in notes) == n_warnings
