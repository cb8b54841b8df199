"""What a comparison keeps on disk, and that a recording that fails stops no other."""

import json

import numpy as np
import pytest
import yaml

from egolane_pgm.comparing.saving import folder_of
from egolane_pgm.experiment import load_experiment
from egolane_pgm.model import prepare_model
from egolane_pgm.results import read_result
from egolane_pgm.scoring.health import detector_errors, doubt, roc_auc
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import LaneTruth
from tests.kits.drives import command, write_experiment


@pytest.fixture
def experiments(tmp_path):
    """Two models on one simulated drive, one on another, one whose recording is not there."""
    recordings = [{"simulate": "quickstart", "seed": k} for k in (1, 1, 2)] + [{"path": "gone.bag"}]
    names = ["paper", "plain", "other", "gone"]
    graphs = ["sensor_failure", "lane_only", "sensor_failure", "sensor_failure"]
    truths = [None, None, None, {"path": "gone.csv"}]
    return [
        write_experiment(
            tmp_path / f"{name}.yaml",
            name=name,
            graph=graph,
            recording=recording,
            ground_truth=truth,
        )
        for name, graph, recording, truth in zip(names, graphs, recordings, truths, strict=True)
    ]


def test_each_recording_has_its_own_directory_and_each_experiment_in_it_a_result(
    experiments, tmp_path
):
    out = tmp_path / "out"
    found = command("compare", *experiments[:3], "--out", out, "--json", tmp_path / "all.json")
    assert found.exit_code == 0, found.output
    folders = sorted(path.name for path in out.iterdir())
    assert folders == ["quickstart_seed_1", "quickstart_seed_2"]
    part = json.loads((out / "quickstart_seed_1" / "comparison.json").read_text())
    whole = json.loads((tmp_path / "all.json").read_text())
    assert part["experiments"] == whole["recordings"][0]["experiments"]
    result = read_result(out / "quickstart_seed_1" / "plain")
    assert np.allclose(result.marginals["Lane"].sum(axis=1), 1)
    scored = ~result.is_crossing
    accuracy = np.mean((result.assigned_lane == result.true_lane)[scored])
    entry = part["experiments"][1]
    assert accuracy == pytest.approx(entry["scores"]["all_frames"]["accuracy"], abs=1e-12)
    assert result.run["blocks"] == 5


def test_what_is_said_of_the_detectors_health_can_be_computed_from_the_result(
    experiments, tmp_path
):
    out = tmp_path / "out"
    assert command("compare", *experiments[:2], "--health", "--out", out).exit_code == 0
    folder = out / "quickstart_seed_1"
    entry = json.loads((folder / "comparison.json").read_text())["experiments"][0]
    result = read_result(folder / "paper")
    errors = detector_errors(result.tentative, result.true_lane, result.is_crossing)
    frames = errors.is_committed
    bad = result.marginals["SensorState"][:, result.values["SensorState"].index("BAD")]
    found = entry["health"]["all_frames"]
    assert found["auc_bad"] == roc_auc(bad[frames], errors.is_wrong[frames])
    score = doubt(result.marginals["Lane"], errors.assigned)
    assert found["auc_doubt"] == roc_auc(score[frames], errors.is_wrong[frames])
    again = score_with_intervals(
        result.marginals["Lane"],
        LaneTruth(result.frame_id, result.true_lane, result.is_crossing),
        result.run["frame_rate"],
    )
    saved = entry["scores"]["all_frames"]
    assert again == {k: v for k, v in saved.items() if k != "mean_log_evidence"}


def test_the_experiment_in_a_result_can_be_run_again(experiments, tmp_path):
    out = tmp_path / "out"
    assert command("compare", experiments[0], experiments[1], "--out", out).exit_code == 0
    kept = yaml.safe_load((out / "quickstart_seed_1/plain/experiment.yaml").read_text())
    assert kept["graph"] == "lane_only"
    again = load_experiment(out / "quickstart_seed_1/plain/experiment.yaml")
    assert prepare_model(again).compiled.n_states == 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_recording_that_fails_is_listed_and_the_others_are_compared(experiments, tmp_path, jobs):
    file = tmp_path / "all.json"
    found = command("compare", *experiments, "--jobs", jobs, "--json", file)
    assert found.exit_code == 1
    assert "failed: gone: " in found.output
    assert "gone.bag: no such file" in found.output
    document = json.loads(file.read_text())
    assert [part["title"] for part in document["recordings"]] == [
        "quickstart, seed 1",
        "quickstart, seed 2",
    ]
    assert [part["title"] for part in document["failed"]] == ["gone"]


def test_where_every_recording_fails_the_first_reason_is_the_one_line(experiments):
    found = command("compare", experiments[3])
    assert found.exit_code == 2
    assert found.output.count("\n") == 1
    assert "gone.bag: no such file" in found.output


def test_a_title_becomes_a_plain_directory_name():
    assert folder_of("quickstart, seed 1") == "quickstart_seed_1"
    assert folder_of("../..") == "recording"
