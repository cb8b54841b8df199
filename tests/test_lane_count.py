"""Whether the lines fit the number of lanes that was said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm import paper
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.labelling import label_experiment
from egolane_pgm.lane_count import WORTH_A_WORD, doubt_of_lanes, log_evidence_by_lanes
from egolane_pgm.loading import Recorded, load_recording
from egolane_pgm.model import make_evidence, prepare_model
from egolane_pgm.running import run_experiment
from egolane_pgm.simulation import simulate
from tests.conftest import needs_compiler
from tests.kits.drives import write_drive

FOLDER = paper.experiments_folder()


@pytest.fixture(scope="module")
def simulated() -> Experiment:
    return load_experiment(FOLDER / "zero_label.yaml")


@pytest.fixture(scope="module")
def recorded(simulated: Experiment) -> Recorded:
    return load_recording(simulated)


def with_lanes(experiment: Experiment, n_lanes: int) -> Experiment:
    return load_experiment(experiment, {"n_lanes": n_lanes})


def test_it_is_the_evidence_of_a_run_with_that_many_lanes(
    simulated: Experiment, recorded: Recorded
) -> None:
    found = log_evidence_by_lanes(simulated, recorded)
    assert list(found) == [2, 3, 4]
    unscored = replace(recorded, truth=None)
    for n_lanes, log_evidence in found.items():
        run = run_experiment(with_lanes(simulated, n_lanes), recorded=unscored)
        assert log_evidence == pytest.approx(run.beliefs.log_evidence.sum())


def test_the_number_of_lanes_that_was_driven_on_is_not_doubted(
    simulated: Experiment, recorded: Recorded
) -> None:
    assert doubt_of_lanes(simulated, recorded) is None


@pytest.mark.parametrize("said", [2, 4])
def test_a_number_that_is_wrong_by_one_is_told(
    said: int, simulated: Experiment, recorded: Recorded
) -> None:
    wrong = with_lanes(simulated, said)
    doubt = doubt_of_lanes(wrong, recorded)
    assert doubt is not None
    assert f"the lines fit a road of 3 lanes better than one of {said}" in doubt
    labels = label_experiment(wrong, recorded=replace(recorded, truth=None))
    assert labels.run.notes[-1] == doubt


@pytest.mark.parametrize("n_lanes", [2, 4])
def test_it_is_told_on_wider_and_narrower_roads_too(n_lanes: int) -> None:
    drive = simulate("quickstart", seed=1, n_lanes=n_lanes)
    lines = Recorded(drive.log, None, np.zeros(0, dtype=np.int64), (), ())
    right = load_experiment(FOLDER / "zero_label.yaml", {"n_lanes": n_lanes})
    assert doubt_of_lanes(right, lines) is None
    for wrong in {max(n_lanes - 1, 2), n_lanes + 1} - {n_lanes}:
        doubt = doubt_of_lanes(with_lanes(right, wrong), lines)
        assert f"a road of {n_lanes} lanes better than one of {wrong}" in str(doubt)


def test_a_road_of_one_lane_is_not_compared(simulated: Experiment, recorded: Recorded) -> None:
    assert log_evidence_by_lanes(with_lanes(simulated, 1), recorded) == {}
    assert list(log_evidence_by_lanes(with_lanes(simulated, 2), recorded)) == [2, 3]


def test_a_frame_alone_tells_nothing(simulated: Experiment, recorded: Recorded) -> None:
    one = replace(recorded, log=recorded.log.take(slice(0, 1)))
    found = log_evidence_by_lanes(simulated, one)
    assert max(found.values()) - min(found.values()) < WORTH_A_WORD
    assert doubt_of_lanes(with_lanes(simulated, 4), one) is None


def test_evidence_that_cannot_be_compared_between_roads_is_not(tmp_path: Path) -> None:
    counting = load_experiment(write_drive(tmp_path))
    recorded = load_recording(counting)
    assert log_evidence_by_lanes(counting, recorded) == {}
    assert doubt_of_lanes(counting, recorded) is None


def test_parameters_of_one_number_of_lanes_fit_no_other(
    simulated: Experiment, recorded: Recorded
) -> None:
    learned = load_experiment(simulated, {"parameters.shoulders": [0.9, 0.9]})
    assert list(log_evidence_by_lanes(learned, recorded)) == [2, 3, 4]
    learned = load_experiment(simulated, {"parameters.sigmas_m": [0.2] * 6})
    make_evidence(prepare_model(learned), recorded.log)
    assert log_evidence_by_lanes(learned, recorded) == {}


@needs_compiler
@pytest.mark.parametrize("name", ["italy_ml", "italy_mld", "spain_mc", "spain_mld"])
def test_the_lines_of_the_paper_s_recordings_tell_how_many_lanes_there_are(
    name: str, recordings: Path
) -> None:
    right = load_experiment(FOLDER / "beyond" / f"geometry_{name}.yaml")
    recorded = load_recording(right)
    assert doubt_of_lanes(right, recorded) is None
    for wrong in (right.n_lanes - 1, right.n_lanes + 1):
        doubt = str(doubt_of_lanes(with_lanes(right, wrong), recorded))
        assert f"a road of {right.n_lanes} lanes better than one of {wrong}" in doubt
