"""The numbers of version 0.1, frozen: whatever is rewritten must give them again.

They stand in `frozen.json`, with the version that made them. Only names may change in this file
(of functions, keys and columns); a number never does, and there is no way to remake them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from joblib import Parallel, delayed

import egolane_pgm as ego
from tests.conftest import needs_compiler

FILE = Path(__file__).with_name("frozen.json")
FROZEN: dict[str, Any] = json.loads(FILE.read_text())["numbers"]
PUBLISHED = ego.experiments_folder() / "paper" / "published.yaml"
RUN_5 = ego.experiments_folder() / "paper" / "run05_italy_mld.yaml"

#: Frames of quickstart whose beliefs are kept.
FRAMES = (0, 1, 50, 200, 411, 600, 750, 900, 1100, 1199)

#: A camera that fits the shipped clips roughly.
CAMERA = {
    "width": 1280, "height": 720, "fx": 1065.1, "fy": 1065.1, "cx": 639.5, "cy": 359.5,
    "height_m": 1.652, "pitch_deg": -6.618, "yaw_deg": -0.859,
}  # fmt: skip

#: The first three pictures of a second of motorway.
STILLS = "tusimple_clips/0601/1494452391590105691/[123].jpg"

#: Detectors compute in single precision, in OpenCV's kernels for the processor at hand.
OFFSET_TOLERANCE_M = 0.01


@pytest.fixture(scope="module")
def ten_runs(recordings: Path) -> list[dict[str, Any]]:
    """What `run_of_paper` gives for the ten runs, made by two processes."""
    return list(Parallel(n_jobs=2)(delayed(run_of_paper)(number) for number in range(1, 11)))


def run_of_paper(number: int) -> dict[str, Any]:
    """Matrices and scores of a run of the paper, whose recording is read once.

    The paper's graph has the recovered parameters. Zero label knows the number of lanes only.
    """
    [run] = ego.reproduce(runs=number, parameters="recovered")
    exact = run_again(run, run.experiment, overrides={"filter": "exact"})
    zero_label = run_again(run, "zero_label", n_lanes=run.experiment.n_lanes)
    return {
        "detector": run.scores["detector"]["confusion"],
        "model": run.scores["model"]["confusion"],
        "assumed_density": scores_of(run),
        "exact": scores_of(exact),
        "zero_label": scores_of(zero_label),
    }


def run_again(result: ego.Result, experiment: Any, **options: Any) -> ego.Result:
    """Run an experiment on the lines and the ground truth of a result."""
    [lines] = result.lines.values()
    return ego.run(lines, experiment=experiment, ground_truth=result.truth, **options)


def scores_of(result: ego.Result) -> list[float]:
    """Accuracy, log-loss, share of sure frames (.95 or more) and mean log evidence."""
    model = result.scores["model"]
    sure = float((posteriors(result)["Lane"].max(axis=1) >= 0.95).mean())
    return [model["accuracy"], model["log_loss"], sure, result.scores["mean_log_evidence"]]


def posteriors(result: ego.Result) -> Mapping[str, np.ndarray]:
    """The posterior of each hidden node, (T, number of its values)."""
    return {node: result.node(node) for node in result.run["values"]}


def assert_frozen(ours: Any, frozen: Any) -> None:
    """Check that numbers are equal up to 1e-9."""
    np.testing.assert_allclose(ours, frozen, rtol=0, atol=1e-9)


def frames_off(ours: Any, published: Any) -> int:
    """Half the sum of the absolute differences of two confusion matrices, rounded up."""
    return -(-int(np.abs(np.subtract(ours, published)).sum()) // 2)


@needs_compiler
@pytest.mark.parametrize("kind", ["detector", "model"])
def test_the_papers_matrices(ten_runs: list[dict[str, Any]], kind: str) -> None:
    """The ten matrices of the detectors' answers, and the ten of the model: 0 and 3 frames off."""
    matrices = [run[kind] for run in ten_runs]
    assert matrices == FROZEN["matrices"][kind]
    theirs = "detector_only" if kind == "detector" else "model"
    published = [run[theirs]["confusion"] for run in yaml.safe_load(PUBLISHED.read_text())["runs"]]
    off = [frames_off(*both) for both in zip(matrices, published, strict=True)]
    assert off == FROZEN["frames_off"][kind]
    assert sum(np.sum(matrix) for matrix in matrices) == 156_028 / 2


@needs_compiler
@pytest.mark.parametrize("model", ["assumed_density", "exact", "zero_label"])
def test_scores_of_the_ten_runs(ten_runs: list[dict[str, Any]], model: str) -> None:
    """The paper's graph with the paper's filter and with the joint one, and zero label."""
    assert_frozen([run[model] for run in ten_runs], FROZEN["ten_runs"][model])


@needs_compiler
def test_em_on_run_1(recordings: Path) -> None:
    """The log evidence after each step of EM without a prior, and the log posterior with one."""
    [run] = ego.reproduce(runs=1, parameters="recovered")
    frozen = FROZEN["em_run_1"]
    for strength, history in ((0.0, frozen["log_evidence"]), (100.0, frozen["log_posterior"])):
        fitted = ego.fit_tables(
            run.model.compiled, run.evidence, strength=strength, iterations=len(history) - 1
        )
        np.testing.assert_allclose(fitted.log_posterior, history, rtol=1e-9)


def test_beliefs_of_quickstart() -> None:
    """The posterior of every hidden node in ten frames."""
    ours = posteriors(ego.run("quickstart"))
    assert ours.keys() == FROZEN["quickstart"].keys()
    for node, frozen in FROZEN["quickstart"].items():
        assert_frozen(ours[node][list(FRAMES)], frozen)


def assert_trials(experiment: Any, trials: int, sampler: str, frozen: list[float]) -> None:
    """Check the value of each trial of an in-sample search for accuracy."""
    study = ego.tune(experiment, trials=trials, overrides={"fit.sampler": sampler}, folds=0)
    assert_frozen(study.trials["accuracy"], frozen)


@pytest.mark.parametrize(("sampler", "trials"), [("evolution", 90), ("tpe", 30)])
def test_a_study_on_quickstart(sampler: str, trials: int) -> None:
    """The values of the trials: of evolution three generations, the first of which is random."""
    assert_trials("quickstart", trials, sampler, FROZEN["study_quickstart"][sampler])


@needs_compiler
@pytest.mark.parametrize("sampler", ["evolution", "tpe"])
def test_a_study_on_run_5(recordings: Path, sampler: str) -> None:
    """The values of 12 trials on 9,952 frames of the paper."""
    assert_trials(RUN_5, 12, sampler, FROZEN["study_run_5"][sampler])


@pytest.mark.parametrize("fit", ["none", "learn", "tune"])
def test_held_out_accuracy_of_quickstart(fit: str) -> None:
    """Five blocks, each with what was fitted on the others (tune: 30 trials each)."""
    overrides = {"fit.method": fit, "fit.trials": 30, "fit.folds": 5}
    overrides |= {"fit.objective": "log_evidence"} if fit == "learn" else {}
    result = ego.run("quickstart", overrides=overrides, held_out=True)
    assert_frozen(result.scores["model"]["accuracy"], FROZEN["held_out_quickstart"][fit])


@needs_compiler
@pytest.mark.parametrize("detector", ["ml", "mc"])
def test_lines_in_three_stills(real_pictures: Path, tmp_path: Path, detector: str) -> None:
    """Offsets, flags and LRI of straight lines and of clothoids in three pictures in a row."""
    if not (real_pictures / STILLS).parent.is_dir():
        pytest.skip(f"real pictures: EGOLANE_DATA has no {Path(STILLS).parent} in camera")
    camera = tmp_path / "camera.yaml"
    camera.write_text(yaml.safe_dump(CAMERA))
    log = ego.detect(
        real_pictures / STILLS,
        camera=camera,
        detector=detector,
        overrides={"recording.frame_rate": 20, "lri_frames": 2},
    )
    frozen = FROZEN["stills"][detector]
    np.testing.assert_allclose(log.offset_m, frozen["offset_m"], rtol=0, atol=OFFSET_TOLERANCE_M)
    for name in ("is_valid", "is_continuous", "lri"):
        np.testing.assert_array_equal(getattr(log, name), frozen[name], name)
