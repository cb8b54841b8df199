"""Single rules of line tracking, each where it decides; and what is kept of a drive cut short."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from types import ModuleType

import numpy as np
import pytest

from egolane_pgm.camera.model import Camera
from egolane_pgm.detectors import FrameLines
from egolane_pgm.detectors import runner as _drive
from egolane_pgm.detectors.simple.tracking import (
    Tracks,
    advance,
    continuous_share,
    expected,
    lines_of,
)
from egolane_pgm.types import InputError
from tests.detectors.simple.test_tracking import NOTHING, at, followed, made, seen


def offset_of(tracks: Tracks, number: int) -> float:
    return float(tracks.mean[tracks.number == number][0, 0])


def test_half_of_the_votes_are_not_more_than_half_and_just_enough_paint_is_enough() -> None:
    rule = made(continuous_share=0.5, continuous_cover=0.4)
    frames = [seen(at(-1.8), cover) for cover in (0.4, 0.39, 0.4, 0.39)]
    history = followed(rule, frames)
    assert [float(continuous_share(t)[0]) for t in history] == [1, 0.5, pytest.approx(2 / 3), 0.5]
    assert [bool(lines_of(t, rule).is_continuous[0]) for t in history] == [True, False, True, False]


def test_a_detection_that_cannot_tell_its_paint_does_not_vote() -> None:
    frames = [seen(at(-1.8), 1.0), *[seen(at(-1.8), float("nan"))] * 6]
    for tracks in followed(made(), frames):
        assert continuous_share(tracks).tolist() == [1.0]


@pytest.mark.parametrize(
    ("rule", "is_followed"),
    [
        ({"gate_m": 0.3, "gate_sigmas": 1000}, False),
        ({"gate_m": 5, "gate_sigmas": 0.5}, False),
        ({"gate_m": 5, "gate_sigmas": 1000}, True),
    ],
)
def test_a_line_must_be_near_in_metres_and_in_standard_deviations(
    rule: dict[str, float], is_followed: bool
) -> None:
    frames = [seen(at(-1.8))] * 12 + [seen(at(-0.9))]
    tracks = followed(made(**rule, tracks_apart_m=0.1, least_lane_m=0.1), frames)[-1]
    assert (tracks.missed[tracks.number == 1] == 0).tolist() == [is_followed]
    assert len(tracks) == (1 if is_followed else 2)


def test_one_line_that_moves_alone_does_not_take_the_others_along() -> None:
    still = [seen(at(-1.8, 1.8))] * 12
    tracks = followed(made(), [*still, seen(at(-1.4))])[-1]
    assert offset_of(tracks, 2) == pytest.approx(1.8, abs=0.02)
    # Nor does one of many: it is the median that counts.
    many = (-5.4, -1.8, 1.8, 5.4, 9.0)
    moved = (-5.4, -1.8, 1.8, 6.2)
    tracks = followed(made(), [seen(at(*many))] * 12 + [seen(at(*moved))])[-1]
    assert offset_of(tracks, 5) == pytest.approx(9.0, abs=0.03)


def test_a_line_not_seen_moves_at_once_by_the_share_of_what_all_others_show() -> None:
    still = [seen(at(-1.8, 1.8, 5.4))] * 12
    for gain in (0.0, 0.5, 1.0):
        tracks = followed(made(shift_gain=gain, motion_gain=0), [*still, seen(at(-1.5, 2.1))])[-1]
        assert offset_of(tracks, 3) == pytest.approx(5.4 + gain * 0.3, abs=0.03)


def test_the_steady_motion_comes_to_rest_where_nothing_tells_of_it() -> None:
    drifting = [seen(at(-1.8 + 0.05 * k, 1.8 + 0.05 * k)) for k in range(30)]
    history = followed(made(motion_gain=0.4), drifting + [NOTHING] * 3)
    motion = [float(t.motion[0]) for t in history]
    assert motion[29] == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(motion[30:], motion[29] * 0.6 ** np.arange(1, 4))


def test_the_covariance_is_that_of_the_kalman_filter() -> None:
    rule = made()
    one = followed(rule, [seen(at(-1.8))])[-1]
    two = advance(one, rule, *seen(at(-1.8)))
    prior = one.covariance[0] + rule.walk
    spread = rule.at @ prior @ rule.at.T + rule.noise
    right = prior - prior @ rule.at.T @ np.linalg.solve(spread, rule.at @ prior)
    scale = np.sqrt(np.diag(right))
    np.testing.assert_allclose(two.covariance[0] / np.outer(scale, scale),
                               right / np.outer(scale, scale), atol=1e-6)  # fmt: skip


def test_a_new_line_is_as_sure_as_its_detection_and_no_wider_than_it_may_wander() -> None:
    for walk in (1e-6, 10.0):
        rule = made(offset_walk_m=walk)
        inverse = np.linalg.pinv(rule.at)
        alone = np.sqrt(np.diag(inverse @ rule.noise @ inverse.T))
        most = np.minimum(alone, 50 * np.sqrt(np.diag(rule.walk)))
        np.testing.assert_allclose(np.sqrt(np.diag(rule.first)), most)


def test_of_two_lines_in_one_place_the_valid_one_stays_however_young() -> None:
    rule = made()
    weak = followed(rule, [seen(at(-1.8))] * 6)[-1]
    strong = followed(rule, [seen(at(-1.8))] * 10)[-1]
    strong = replace(strong, number=np.array([2]))
    both = {
        f.name: np.concatenate([getattr(weak, f.name), getattr(strong, f.name)])
        for f in fields(Tracks)
        if f.name not in ("motion", "n_started")
    }
    tracks = advance(replace(strong, **both, n_started=2), rule, *NOTHING)
    assert tracks.number.tolist() == [2]


def test_a_line_beyond_one_that_is_seen_as_often_bounds_nothing_though_neither_is_valid() -> None:
    tracks = followed(made(least_lane_m=2.8, tracks_apart_m=0.5), [seen(at(1.8, 3.2))] * 3)[-1]
    assert tracks.mean[:, 0] == pytest.approx([1.8], abs=0.01)
    assert not tracks.is_valid.any()


# --- what is kept of a drive ---------------------------------------------------------------------


def lines(count: int, lri: float = 1.0) -> FrameLines:
    flags = np.zeros(count, dtype=bool)
    return FrameLines(at(*np.arange(count) * 3.5), flags, flags, np.full(count, lri))


@pytest.mark.parametrize("reason", [KeyboardInterrupt(), InputError("picture 4: is torn")])
def test_what_was_detected_before_a_drive_ends_early_is_kept(reason: BaseException) -> None:
    def frames() -> Iterator[tuple[int, FrameLines]]:
        for frame_id in (3, 4, 6):
            yield frame_id, lines(2)
        raise reason

    found = _drive.collect(frames(), 10.0, "here")
    assert found.stopped is reason
    assert found.log is not None
    assert found.log.frame_id.tolist() == [3, 4, 6]


def test_a_long_drive_is_packed_in_pieces_and_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_drive, "_PACK", 4)
    found = _drive.collect(((k, lines(1 + k % 3)) for k in range(10)), 10.0, "here")
    assert found.stopped is None
    assert found.log is not None
    assert found.log.frame_id.tolist() == list(range(10))
    assert np.isfinite(found.log.offset_m).sum(axis=1).tolist() == [1 + k % 3 for k in range(10)]


def test_a_count_of_detections_is_not_negative() -> None:
    _drive._check(lines(2, 0.0), "here")
    with pytest.raises(InputError, match="here: a line's lri is not a count of detections"):
        _drive._check(lines(2, -1.0), "here")


def test_straight_lines_have_no_curvature_however_they_wander() -> None:
    rng = np.random.default_rng(0)
    frames = [
        seen(np.array([[-1.8 + rng.normal(0, 0.2), rng.normal(0, 0.02), 0, 0]])) for _ in range(40)
    ]
    for tracks in followed(made(curved=False), frames):
        assert (tracks.mean[:, 2:] == 0).all()


def test_lines_are_expected_where_the_steady_motion_takes_them() -> None:
    drifting = [seen(at(-1.8 + 0.05 * k, 1.8 + 0.05 * k)) for k in range(30)]
    tracks = followed(made(), drifting)[-1]
    np.testing.assert_allclose(expected(tracks)[:, 0], np.array([-1.8, 1.8]) + 1.5, atol=0.03)
    order = np.argsort(tracks.mean[:, 0])
    np.testing.assert_array_equal(expected(tracks), tracks.mean[order] + tracks.motion)


# --- one camera or two ---------------------------------------------------------------------------


def test_a_stereo_detector_needs_two_cameras_and_how_far_they_are_apart() -> None:
    one = Camera(width=640, height=360, fx=500, fy=500, cx=320, cy=180, height_m=1.5)
    for is_stereo in (False, True):
        module = ModuleType("mine")
        module.STEREO = is_stereo  # type: ignore[attr-defined]
        detector = _drive.Detector("mine", module, {}, "recording.detector")
        if not is_stereo:
            _drive.check_pair(detector, one, False, "here")
            with pytest.raises(InputError, match="here: detector mine looks at one camera only"):
                _drive.check_pair(detector, one, True, "here")
            continue
        with pytest.raises(InputError, match="here: detector mine needs the pictures of a second"):
            _drive.check_pair(detector, replace(one, baseline_m=0.5), False, "here")
        with pytest.raises(InputError, match="baseline_m of the camera"):
            _drive.check_pair(detector, one, True, "here")
        _drive.check_pair(detector, replace(one, baseline_m=0.5), True, "here")
