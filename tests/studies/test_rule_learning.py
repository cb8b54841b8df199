"""Parameters of evidence rules learned from labelled frames: EM of the line geometry."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.drives import Drive
from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import fitting
from egolane_pgm.evidence.line_geometry.model import LANE_M, LineModel, line_model, places
from egolane_pgm.loading import load_experiment
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.studies.fits import apply_fit, fit_learn, fit_rule
from egolane_pgm.types import FloatArray, InputError, IntArray
from tests.conftest import needs_compiler
from tests.kits.drives import geometry, write_drive
from tests.kits.studies import drive_of, scrambled
from tests.reference.line_geometry import log_prior

W = LANE_M


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
                lines.append((place[now, k] + rng.normal(0, model.sigmas_m[k]) - u, c))
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
@pytest.mark.parametrize("strength", [30.0, 1000.0])
def test_every_iteration_increases_the_log_posterior(
    monkeypatch: pytest.MonkeyPatch, strength: float
) -> None:
    monkeypatch.setattr(fitting, "STRENGTH", strength)
    offset, kind, lane = drawn_from(truth_model(), 300, seed=1)
    first = model = line_model(3, resolved())
    history = []
    for _ in range(15):
        found = fitting.expect(offset, kind, lane, model, 16)
        history.append(found.log_likelihood + log_prior(model, first))
        model = fitting.maximise(found, model, first)
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1])).all()
    assert history[-1] > history[0] + 1


@needs_compiler
def test_em_finds_the_model_that_the_frames_were_drawn_from(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fitting, "STRENGTH", 1.0)
    monkeypatch.setattr(fitting, "ITERATIONS", 40)
    true = truth_model()
    offset, kind, lane = drawn_from(true, 4000, seed=2)
    found = fitting.fit_lines(offset, kind, lane, line_model(3, resolved()), 16)
    np.testing.assert_allclose(found.rates[:, :4], true.rates[:, :4], atol=0.08)
    np.testing.assert_allclose(found.class_shares[:4], true.class_shares[:4], atol=0.04)
    np.testing.assert_allclose(found.sigmas_m[:4], true.sigmas_m[:4], atol=0.05)
    np.testing.assert_allclose(found.shoulders, true.shoulders, atol=0.05)
    np.testing.assert_allclose(found.clutter, true.clutter, atol=0.003)


# --- fits ----------------------------------------------------------------------------------------


def drive(**keys: Any) -> Drive:
    return drive_of(geometry(**keys))


def learned(one: Drive, train: Any = None) -> Any:
    train = np.arange(len(one)) if train is None else np.asarray(train)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit_learn([one.mask_labels(train)], [train], None)


@needs_compiler
def test_only_the_labels_of_the_training_frames_are_used() -> None:
    one, train = drive(), np.arange(600)
    others = np.union1d(np.arange(600, len(one)), np.flatnonzero(one.is_crossing[one.rows]))
    assert learned(scrambled(one, others), train) == learned(one, train)
    assert learned(scrambled(one, train), train) != learned(one, train) != learned(one)


@needs_compiler
def test_learning_on_frames_without_some_lane_warns_and_keeps_its_prior() -> None:
    one = drive()
    some = np.flatnonzero((one.true_lane[one.rows] != 4) & ~one.is_crossing[one.rows])
    with pytest.warns(UserWarning, match="no frame to learn from has lane 4"):
        found = fit_rule([one], [some])
    rates = np.reshape(found["rates"], (4, 7))
    generic = line_model(4, one.model.parameters).rates
    np.testing.assert_allclose(rates[3], generic[3])
    assert np.abs(rates[0] - generic[0]).max() > 1e-3


@needs_compiler
def test_learning_again_from_what_was_learned_gives_the_same() -> None:
    """The start is generic whatever the experiment holds, else blocks would leak."""
    one = drive()
    found = learned(one)
    assert learned(replace(one, model=apply_fit(one.model, found))) == found


@needs_compiler
@pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning")
def test_detectors_with_other_metres_are_pooled_in_lane_widths() -> None:
    """The same drive, of which another detector reports longer metres and lacks seven frames."""
    first = drive()
    kept = slice(7, None)
    log = first.log.take(kept)
    other = replace(
        first,
        log=replace(log, offset_m=log.offset_m * 1.1),
        true_lane=first.true_lane[kept],
        is_crossing=first.is_crossing[kept],
    )
    train = [np.arange(len(each)) for each in (first, other)]
    alone, pooled = fit_rule([first], train[:1]), fit_rule([first, other], train)
    assert pooled["fallback_width_m"] == alone["fallback_width_m"]
    np.testing.assert_allclose(np.asarray(pooled["sigmas_m"]), alone["sigmas_m"], atol=0.02)


def test_a_rule_that_learns_what_it_does_not_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rule.py").write_text(
        "from egolane_pgm.evidence import counting\n"
        "PARAMETERS, PROVIDES = counting.PARAMETERS, counting.PROVIDES\n"
        "evidence, LEARNED = counting.evidence, ('bonus_value',)\n"
        "def fit(parts, n_lanes, parameters):\n"
        "    return {'bonus_value': 2.0, 'max_lri': 7.0}\n"
    )
    one = drive_of(load_experiment(write_drive(tmp_path, 60, evidence="./rule.py")))
    with pytest.raises(InputError, match=r"fit\(\) returned max_lri, not one of LEARNED"):
        learned(one)
