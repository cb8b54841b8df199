"""Learning from labelled frames: EM of the line geometry, and what is held out."""

from __future__ import annotations

import functools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from egolane_pgm.drive import Drive, Recorded, load_recording
from egolane_pgm.held_out import held_out_result
from egolane_pgm.learning import fit

from egolane_pgm.evidence.line_geometry import rule as line_geometry
from egolane_pgm.evidence.line_geometry.fitting import expect, fit_lines
from egolane_pgm.evidence.line_geometry.model import LineModel, line_model, places
from egolane_pgm.experiment import load_experiment
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.tools.files import plain
from egolane_pgm.types import FloatArray, IntArray, LaneTruth
from tests.conftest import needs_compiler
from tests.kits.drives import done, refused, write_drive

W = 3.6
GEOMETRY: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
}


def resolved(n_lanes: int = 3, **given: object) -> Parameters:
    return resolve_parameters(line_geometry.PARAMETERS, {"lane_width_m": W, **given}, n_lanes)


def truth_model() -> LineModel:
    """A detector that is not the generic one."""
    generic = line_model(3, resolved())
    rates = generic.rates * np.array([1.05, 0.6, 1.0, 0.8, 3.0, 2.0])
    shares = np.tile([0.02, 0.8, 0.1, 0.08], (6, 1))
    shares[0] = 0.8, 0.1, 0.05, 0.05
    sigma = np.array([0.12, 0.2, 0.15, 0.25, 0.2, 0.2])
    return LineModel(rates, shares, sigma, np.array([0.8, 1.0]), np.array([0.001, 0.01, 0, 0.004]))


def drawn_from(
    model: LineModel, n_frames: int, seed: int, lanes: tuple[int, ...] = (0, 1, 2)
) -> tuple[FloatArray, IntArray, IntArray]:
    """Frames as the model has them: offsets (T, L), classes (T, L), lanes (T,) from 0."""
    rng = np.random.default_rng(seed)
    lane = rng.choice(lanes, n_frames).astype(np.int64)
    place = places(model, W)
    frames: list[list[tuple[float, int]]] = []
    for now in lane:
        u = rng.uniform(-W / 2, W / 2)
        lines = []
        for k, number in enumerate(rng.poisson(model.rates[now])):
            for _ in range(number):
                c = int(rng.choice(4, p=model.class_shares[k] / model.class_shares[k].sum()))
                lines.append((place[now, k] + rng.normal(0, model.sigma_m[k]) - u, c))
        for c, number in enumerate(rng.poisson(32 * model.clutter)):
            lines += [(rng.uniform(-16, 16), c) for _ in range(number)]
        frames.append(lines)
    width = max(map(len, frames))
    offset, kind = np.zeros((n_frames, width)), np.full((n_frames, width), -1, dtype=np.int64)
    for t, lines in enumerate(frames):
        for i, (o, c) in enumerate(lines):
            offset[t, i], kind[t, i] = o, c
    return offset, kind, lane


@needs_compiler
@pytest.mark.parametrize("strength", [0.0, 30.0, 1000.0])
def test_every_iteration_increases_the_log_posterior(strength: float) -> None:
    offset, kind, lane = drawn_from(truth_model(), 300, seed=1)
    first = line_model(3, resolved())
    _, history = fit_lines(offset, kind, lane, first, W, 16, strength=strength, iterations=15)
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1])).all()
    assert history[-1] > history[0] + 1


@needs_compiler
def test_em_finds_the_model_that_the_frames_were_drawn_from() -> None:
    true = truth_model()
    offset, kind, lane = drawn_from(true, 4000, seed=2)
    found, _ = fit_lines(
        offset, kind, lane, line_model(3, resolved()), W, 16, strength=1, iterations=40
    )
    np.testing.assert_allclose(found.rates[:, :4], true.rates[:, :4], atol=0.08)
    np.testing.assert_allclose(found.class_shares[:4], true.class_shares[:4], atol=0.04)
    np.testing.assert_allclose(found.sigma_m[:4], true.sigma_m[:4], atol=0.05)
    np.testing.assert_allclose(found.shoulders, true.shoulders, atol=0.05)
    np.testing.assert_allclose(found.clutter, true.clutter, atol=0.003)


def test_the_expected_counts_add_up_to_the_lines() -> None:
    offset, kind, lane = drawn_from(truth_model(), 200, seed=3)
    found = expect(offset, kind, lane, line_model(3, resolved()), W, 16)
    n_lines = np.count_nonzero(kind >= 0)
    assert found.lines.sum() + found.clutter.sum() == pytest.approx(n_lines)
    np.testing.assert_allclose(
        found.classes.sum(axis=0) + found.clutter, np.bincount(kind[kind >= 0], minlength=4)
    )
    np.testing.assert_allclose(found.moment0, found.lines.sum(axis=0))
    assert found.frames.tolist() == np.bincount(lane, minlength=3).tolist()


def test_a_prior_worth_more_than_the_frames_is_kept() -> None:
    offset, kind, lane = drawn_from(truth_model(), 100, seed=4)
    first = line_model(3, resolved())
    found, _ = fit_lines(offset, kind, lane, first, W, 16, strength=1e9)
    np.testing.assert_allclose(found.rates, first.rates, atol=1e-5)
    np.testing.assert_allclose(found.sigma_m, first.sigma_m, atol=1e-5)


def test_a_lane_without_a_frame_keeps_the_first_guess() -> None:
    offset, kind, lane = drawn_from(truth_model(), 300, seed=5, lanes=(0, 1))
    first = line_model(3, resolved())
    for strength in (0.0, 50.0):
        found, _ = fit_lines(offset, kind, lane, first, W, 16, strength=strength)
        np.testing.assert_allclose(found.rates[2], first.rates[2])
        assert np.abs(found.rates[0] - first.rates[0]).max() > 0.05
        assert all(np.isfinite(getattr(found, f)).all() for f in ("rates", "sigma_m", "clutter"))


# --- experiments ---------------------------------------------------------------------------------


@functools.cache
def prepared(folder: Path, **changes: Any) -> tuple[Any, Model, Recorded]:
    experiment = load_experiment(write_drive(folder, 600, **GEOMETRY, **changes))
    return experiment, prepare_model(experiment), load_recording(experiment)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("drive")


@needs_compiler
def test_only_the_labels_of_the_training_frames_are_looked_at(folder: Path) -> None:
    experiment, model, recorded = prepared(folder)
    truth = recorded.truth
    assert truth is not None
    train = np.flatnonzero(np.arange(len(truth)) < 300)
    other_lane = np.where(np.arange(len(truth)) < 300, truth.lane, 4 - truth.lane)
    lane = np.where(truth.is_crossing, 4 - other_lane, other_lane)
    changed = Recorded(
        recorded.log,
        LaneTruth(truth.frame_id, lane, truth.is_crossing),
        recorded.scored,
        (),
        (),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert fit(Drive(experiment, model, recorded), train) == fit(
            Drive(experiment, model, changed), train
        )
        assert fit(Drive(experiment, model, recorded), train) != fit(
            Drive(experiment, model, recorded), np.arange(len(truth))
        )


@needs_compiler
def test_learning_on_frames_without_some_lane_warns_and_keeps_its_prior(folder: Path) -> None:
    experiment, model, recorded = prepared(folder)
    assert recorded.truth is not None
    lane = recorded.truth.lane
    some = np.flatnonzero((lane != 3) & ~recorded.truth.is_crossing)
    with pytest.warns(UserWarning, match="no frame to learn from has lane 3"):
        found = fit(Drive(experiment, model, recorded), some)
    rates = np.reshape(found["rates"], (3, 6))
    generic = line_model(3, model.parameters).rates
    np.testing.assert_allclose(rates[2], generic[2])
    assert np.abs(rates[0] - generic[0]).max() > 1e-3


@needs_compiler
def test_what_is_held_out_is_believed_with_parameters_of_the_other_blocks(folder: Path) -> None:
    experiment, model, recorded = prepared(folder)
    assert recorded.truth is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        drive = Drive(experiment.model_copy(update={"fit": "learn"}), model, recorded)
        result = held_out_result(drive, n_blocks=3)
        found = fit(drive, np.flatnonzero(result.block != 0))
        assert result.run["parameters_per_block"][0] == plain(found)
    assert result.scores["model"]["accuracy"] > 0.9


@needs_compiler
def test_learning_again_from_what_was_learned_gives_the_same(folder: Path) -> None:
    """The first guess is generic whatever the experiment holds, else blocks would leak."""
    experiment, model, recorded = prepared(folder)
    assert recorded.truth is not None
    everything = np.arange(len(recorded.truth))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = fit(Drive(experiment, model, recorded), everything)
        again = experiment.model_copy(update={"parameters": found})
        again._source, again._folder = experiment.source, experiment.folder
        assert fit(Drive(again, prepare_model(again), recorded), everything) == found


@needs_compiler
def test_the_learned_experiment_can_be_run_and_says_what_it_has_seen(tmp_path: Path) -> None:
    write_drive(tmp_path, 600, **GEOMETRY)
    out = tmp_path / "learned_drive.yaml"
    said = done("learn", tmp_path / "experiment.yaml", "--out", out, "--blocks", "3").output
    assert "held out, 3 blocks:" in said
    assert "accuracy" in said
    content = yaml.safe_load(out.read_text())
    assert content["name"] == "learned_drive"
    assert content["tuned_on"] == "same_frames"
    assert np.shape(content["parameters"]["rates"]) == (3, 6)
    said = done("run", out, "--no-figures", "--out", tmp_path / "result").output
    assert "in-sample" in said
    # On another road the numbers of lanes must fit.
    said = refused(
        "run", out, "--recording", tmp_path / "lines.csv", "--n-lanes", "4", "--out", tmp_path / "r"
    )
    assert "parameters.rates: " in said


def test_learning_needs_ground_truth(tmp_path: Path) -> None:
    said = refused("learn", write_drive(tmp_path, **GEOMETRY, ground_truth=None))
    assert said.endswith("ground_truth: is missing, learning needs it")


def test_settings_for_tables_are_refused_where_the_rule_learns(tmp_path: Path) -> None:
    said = refused("learn", write_drive(tmp_path, **GEOMETRY), "--set", "learning.labels=false")
    assert "learning: is about the tables of a graph" in said
    assert "line_geometry learns its own parameters, from labels" in said
