"""Lines followed over time: filter, LRI, validity, votes, new lines and lost ones."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.detectors.simple.parameters import TRACKING
from egolane_pgm.vision.detectors.simple.tracking import (
    Rules,
    Tracks,
    advance,
    lines_of,
    no_tracks,
    rules,
)

NOTHING = np.zeros((0, 4)), np.zeros(0)


def made(curve: str = "clothoid", **given: object) -> Rules:
    return rules(resolve_parameters(TRACKING, given, 1), curve=curve)


def at(*offsets: float, heading: float = 0.0, curvature: float = 0.0) -> FloatArray:
    return np.array([[o, heading, curvature, 0.0] for o in offsets]).reshape(-1, 4)


def followed(rule: Rules, frames: list[tuple[FloatArray, FloatArray]]) -> list[Tracks]:
    tracks, history = no_tracks(rule), []
    for shape, coverage in frames:
        tracks = advance(tracks, rule, shape, coverage)
        history.append(tracks)
    return history


def seen(shape: FloatArray, coverage: float = 0.5) -> tuple[FloatArray, FloatArray]:
    return shape, np.full(len(shape), coverage)


def test_the_lri_counts_detections_in_the_last_ten_frames() -> None:
    rng = np.random.default_rng(0)
    hits = np.concatenate([np.ones(12, dtype=bool), rng.random(60) < 0.8])
    rule = made()
    history = followed(rule, [seen(at(-1.8)) if hit else NOTHING for hit in hits])
    for t, tracks in enumerate(history):
        assert tracks.number.tolist() == [1]
        assert tracks.lri[0] == hits[max(0, t - 9) : t + 1].sum()


def validity(hits: Iterable[bool]) -> BoolArray:
    """Whether a line that is detected in these frames is valid, frame by frame."""
    history = followed(made(), [seen(at(-1.8)) if hit else NOTHING for hit in hits])
    return np.array([bool(tracks.is_valid.any()) for tracks in history])


@pytest.mark.parametrize(("every", "from_frame"), [(1000, 9), (5, 16), (3, 34)])
def test_a_line_that_is_missed_now_and_then_becomes_valid_in_proportion(
    every: int, from_frame: int
) -> None:
    hits = np.arange(200) % every != every - 1
    valid = validity(hits)
    assert not valid[:from_frame].any()
    assert valid[from_frame:].all()


def test_the_filter_has_less_noise_than_single_frames_and_no_bias() -> None:
    rng = np.random.default_rng(1)
    true = np.array([-1.8, 0.01, 3e-4, 0.0])
    rule = made()
    x = np.linspace(6, 30, 4)
    columns = np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6], axis=1)
    noise = np.linspace(0.12, 0.35, 4)
    frames = []
    for _ in range(300):
        # A parabola through places that are off, and a rate of its own.
        places = columns @ true + noise * rng.normal(size=4)
        parabola = np.linalg.lstsq(columns[:, :3] / noise[:, None], places / noise)[0]
        frames.append(seen(np.append(parabola, true[3] + 2e-5 * rng.normal())[None]))
    history = followed(rule, frames)[50:]
    for distance in (6.0, 15.0, 30.0):
        row = np.array([1, distance, distance**2 / 2, distance**3 / 6])
        raw = np.array([shape[0] @ row for shape, _ in frames[50:]]) - true @ row
        ours = np.array([t.mean[0] @ row for t in history]) - true @ row
        assert abs(ours.mean()) < 0.1
        assert ours.std() < 0.8 * raw.std()


@pytest.mark.parametrize("sideways", [-0.5, -0.2, 0.2, 0.5])
def test_a_lane_change_keeps_every_line_its_number(sideways: float) -> None:
    """As fast as 0.5 m per frame (1.5 m/s, three pictures per second), after a gentle start."""
    lines = np.arange(-3, 4) * 3.6 - 1.8
    shift = np.cumsum([0.0] * 12 + list(np.linspace(0, sideways, 6)) + [sideways] * 5)
    frames = [seen(at(*lines + s)) for s in shift]
    rule = made()
    history = followed(rule, frames)
    for tracks, s in zip(history[-3:], shift[-3:], strict=True):
        for number, mean in zip(tracks.number, tracks.mean, strict=True):
            if number <= len(lines) and abs(lines[number - 1] + s) < 8:
                assert mean[0] == pytest.approx(lines[number - 1] + s, abs=0.3)
    within = np.abs(lines + shift[-1]) < 8
    assert set(np.flatnonzero(within) + 1) <= set(history[-1].number.tolist())


def test_lines_not_seen_move_with_those_that_are() -> None:
    rule = made()
    frames = [seen(at(-5.4, -1.8, 1.8))] * 12
    frames += [seen(at(-5.4 + 0.1 * k, -1.8 + 0.1 * k)) for k in range(1, 8)]
    tracks = followed(rule, frames)[-1]
    hidden = tracks.mean[tracks.number == 3]
    assert hidden[0, 0] == pytest.approx(1.8 + 0.7, abs=0.25)


def test_a_new_line_that_is_not_seen_again_dies_soon_a_proven_one_late() -> None:
    rule = made()
    once = followed(rule, [seen(at(-1.8)), *[NOTHING] * 3])
    assert [len(t) for t in once] == [1, 1, 1, 0]
    proven = followed(rule, [seen(at(-1.8))] * 10 + [NOTHING] * 10)
    assert [len(t) for t in proven[10:]] == [1] * 9 + [0]


def test_dashed_and_continuous_follow_the_majority_of_the_last_votes() -> None:
    rule = made(continuous_cover=0.8)
    rng = np.random.default_rng(3)
    frames = []
    for _ in range(60):
        # A dashed line that looks whole in one frame of five, a continuous one with holes.
        cover = np.array([0.95 if rng.random() < 0.2 else 0.5, 0.4 if rng.random() < 0.2 else 1])
        frames.append((at(-1.8, 1.8), cover))
    history = followed(rule, frames)
    for tracks in history[20:]:
        assert lines_of(tracks, rule).is_continuous.tolist() == [False, True]


def test_lines_beyond_a_valid_continuous_one_are_hidden_unless_asked_for() -> None:
    cover = np.array([0.4, 1.0, 0.4, 0.4, 1.0, 1.0])
    frames = [(at(-5.4, -1.8, 1.8, 5.4, 9.0, 12.6), cover)] * 12
    for beyond, seen_then in (
        ("hide", [-1.8, 1.8, 5.4, 9.0]),
        ("keep", [-5.4, -1.8, 1.8, 5.4, 9.0, 12.6]),
    ):
        rule = made(beyond_edge=beyond)
        history = followed(rule, frames)
        # Not before it is sure.
        assert len(lines_of(history[5], rule).lri) == 6
        np.testing.assert_allclose(lines_of(history[-1], rule).offset_m, seen_then, atol=0.05)
    # The car itself may be beyond what was the edge: each side has its own.
    rule = made(beyond_edge="hide")
    crossed = [
        (at(-1.8, 1.8, 5.4) - [[0.3 * k, 0, 0, 0]], np.array([0.4, 1, 0.4])) for k in range(14)
    ]
    history = followed(rule, [(at(-1.8, 1.8, 5.4), np.array([0.4, 1, 0.4]))] * 12 + crossed)
    assert lines_of(history[-1], rule).offset_m.round(1).tolist() == [-2.1, 1.5]


def test_a_line_close_beyond_another_bounds_no_lane_and_is_given_up() -> None:
    rule = made()
    tracks = followed(rule, [seen(at(-4.1, -1.7, 1.9, 5.5))] * 12)[-1]
    assert sorted(tracks.mean[:, 0].round(1).tolist()) == [-1.7, 1.9, 5.5]
    # On the other side of the car, or where the nearer one is seldom seen, it stays.
    tracks = followed(rule, [seen(at(-0.9, 1.5))] * 12)[-1]
    assert len(tracks) == 2
    often = [seen(at(-4.1, -1.7) if k % 4 == 0 else at(-4.1)) for k in range(14)]
    assert -4.1 in followed(rule, often)[-1].mean[:, 0].round(1)


def offset_of(tracks: Tracks, number: int) -> float:
    return float(tracks.mean[tracks.number == number][0, 0])


def test_one_line_that_moves_alone_does_not_take_the_others_along() -> None:
    still = [seen(at(-1.8, 1.8))] * 12
    tracks = followed(made(), [*still, seen(at(-1.4))])[-1]
    assert offset_of(tracks, 2) == pytest.approx(1.8, abs=0.02)


def test_the_covariance_equals_a_kalman_filter() -> None:
    rule = made()
    one = followed(rule, [seen(at(-1.8))])[-1]
    two = advance(one, rule, *seen(at(-1.8)))
    prior = one.covariance[0] + rule.walk
    spread = rule.at @ prior @ rule.at.T + rule.noise
    right = prior - prior @ rule.at.T @ np.linalg.solve(spread, rule.at @ prior)
    scale = np.sqrt(np.diag(right))
    np.testing.assert_allclose(two.covariance[0] / np.outer(scale, scale),
                               right / np.outer(scale, scale), atol=1e-6)  # fmt: skip
