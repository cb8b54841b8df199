"""The parameters of a camera detector are searched like those of graph and evidence rule."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pyarrow import parquet

from egolane_pgm.experiment import load_experiment
from egolane_pgm.running import run_experiment
from tests.kits.drives import done, refused, rewritten, write_experiment

FRAMES = 12
BOUNDS = {"detector.least_rise": [2, 60], "detector.least_score": [0.1, 0.99]}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated drive, and an experiment that looks at its pictures."""
    folder = tmp_path_factory.mktemp("seen") / "drive"
    done("simulate", "a4", "--images", "--frames", str(FRAMES), "--out", folder)
    return write_experiment(
        folder / "pictures.yaml",
        name="seen",
        recording={"path": "images", "camera": "camera.yaml", "detector": "ml"},
        n_lanes=4,
        tuning={"search": ["detector"], "objective": "log_loss", "parameters": BOUNDS},
    )


def test_each_trial_looks_at_the_pictures_with_its_own_values(pictures: Path) -> None:
    out = pictures.parent / "out"
    words = ("--in-sample-only", "--no-figures", "--trials", "4", "--out", out)
    done("tune", pictures, *words)
    rows = parquet.read_table(out / "seen" / "trials.parquet").to_pylist()
    assert len({row["log_loss_in_sample"] for row in rows}) > 1
    current = load_experiment(pictures)
    for row in rows:
        values = {key: row[f"detector.{key}"] for key in ("least_rise", "least_score")}
        recording = current.recording.model_copy(update={"detector_parameters": values})
        run = run_experiment(current.model_copy(update={"recording": recording}))
        assert run.scores["model"]["log_loss"] == pytest.approx(row["log_loss_in_sample"])
    best = min(rows, key=lambda row: row["log_loss_in_sample"])
    tuned = load_experiment(out / "seen" / "best.yaml")
    for key in ("least_rise", "least_score"):
        assert tuned.recording.detector_parameters[key] == best[f"detector.{key}"]
    document = json.loads((out / "seen" / "study.json").read_text())
    # Graph and evidence rule keep their values.
    assert set(document["space"]["searched"]) == set(BOUNDS)
    assert document["space"]["fixed"]["seen"]["sigma1"] == 0.4


def test_a_recording_without_a_detector_has_none_to_search(pictures: Path) -> None:
    changes = {"recording": {"simulate": "a4"}, "ground_truth": None}
    lines = rewritten(pictures, pictures.with_name("lines.yaml"), **changes)
    assert "tuning.search: detector: the recording has none" in refused("tune", lines)


def test_bounds_of_a_detector_are_asked_for(pictures: Path) -> None:
    said = refused("tune", pictures, "-p", "detector.least_rise=4", "-p", "detector.least_score=1")
    assert "there is nothing to search" in said
    said = refused("tune", pictures, "-p", "detector.least_ris=[1,2]")
    assert "did you mean 'detector.least_rise'?" in said
