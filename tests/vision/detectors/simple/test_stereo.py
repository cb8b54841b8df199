"""The road plane from two cameras, and the objects on it, on drawn pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, axes, image_to_road, road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors.runner import detect, find_detector, start
from egolane_pgm.vision.detectors.simple import fit as _fit
from egolane_pgm.vision.detectors.simple import stereo as _stereo
from tests.kits.stereo_pairs import DRAWN, OFFSETS, PAIR, K, drawn, plane_of, settled
from tests.kits.vehicles import car, lorry

pitches = st.floats(-8, 4)
rolls = st.floats(-4, 4)
heights = st.floats(1.0, 2.5)


@given(pitches, st.floats(-5, 5), rolls, heights, st.floats(5, 60), st.floats(-8, 8))
def test_the_disparity_of_the_road_equals_its_projection_in_both_cameras(
    pitch: float, yaw: float, roll: float, height: float, x: float, y: float
) -> None:
    left = replace(PAIR, pitch_deg=pitch, yaw_deg=yaw, roll_deg=roll, height_m=height)
    assert left.baseline_m is not None
    ahead, aside, up = left.baseline_m * axes(left)[0]
    right = replace(left, lateral_m=left.lateral_m + aside, height_m=left.height_m + up)
    u, v = road_to_image(left, x, y)
    other_u, other_v = road_to_image(right, x - ahead, y)
    assert other_v == pytest.approx(v, abs=1e-6)
    expected = _stereo.disparity_at(_stereo.ground_plane(left), u, v)
    assert u - other_u == pytest.approx(expected, abs=1e-6)


@settings(max_examples=20)
@given(st.floats(-2, 2), st.floats(-1, 1), st.floats(0.95, 1.05), st.integers(0, 99))
def test_a_plane_is_found_among_many_points_that_are_not_on_it(
    pitch: float, roll: float, heave: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    true = replace(
        PAIR,
        pitch_deg=PAIR.pitch_deg + pitch,
        roll_deg=PAIR.roll_deg + roll,
        height_m=PAIR.height_m * heave,
    )
    u, v = rng.uniform(0, 640, 2000), rng.uniform(170, 300, 2000)
    disparity = _stereo.disparity_at(_stereo.ground_plane(true), u, v) + rng.normal(0, 0.2, 2000)
    stands = u < 260
    disparity[stands] = rng.uniform(25, 40, stands.sum())
    plane = _stereo.fit_plane(PAIR, u, v, disparity)
    assert plane is not None
    away = _stereo.disparity_at(plane - _stereo.ground_plane(true), u, v)
    assert np.abs(away).max() < 0.2


@pytest.mark.parametrize("kind", ["noise", "few", "wall"])
def test_no_plane_is_found_in_points_that_are_not_on_one(kind: str) -> None:
    rng = np.random.default_rng(1)
    n_points = 100 if kind == "few" else 2000
    u, v = rng.uniform(0, 640, n_points), rng.uniform(170, 300, n_points)
    flat = _stereo.disparity_at(_stereo.ground_plane(PAIR), u, v)
    disparity = {
        "few": flat,
        "wall": np.full(n_points, 30.0),
        "noise": rng.uniform(0, 60, n_points),
    }
    assert _stereo.fit_plane(PAIR, u, v, disparity[kind]) is None


@pytest.mark.parametrize("rows", [4, 1])
def test_the_plane_of_an_empty_road_is_the_cameras(rows: int) -> None:
    camera = DRAWN
    pair, plane, disparity = plane_of(drawn(), camera, match_rows=rows)
    assert plane is not None
    height, pitch, roll = _stereo.pose(camera, plane)
    assert height == pytest.approx(camera.height_m, rel=0.02)
    assert pitch == pytest.approx(camera.pitch_deg, abs=0.1)
    assert roll == pytest.approx(0, abs=0.1)
    # Row by row: B / Z of the road under each pixel.
    x, _ = image_to_road(camera, pair.u, pair.v)
    depth = x * axes(camera)[2, 0] - camera.height_m * axes(camera)[2, 2]
    expected = camera.fx * 0.4 / depth
    away = (disparity - expected).ravel()[pair.points]
    assert np.nanmedian(np.abs(away)) < 0.5
    assert np.isfinite(away).mean() > 0.6


def test_the_pitch_of_a_frame_is_found_and_its_lines_are_where_they_are() -> None:
    frame = drawn(more_pitch_deg=1.2)
    _, plane, _ = plane_of(frame, DRAWN)
    assert plane is not None
    pitch = float(_stereo.pose(DRAWN, plane)[1])
    assert pitch == pytest.approx(frame.camera.pitch_deg, abs=0.15)

    parameters = settled()
    view = _fit.view_for(DRAWN, parameters)
    seen, is_road = _stereo.on_road(view, parameters)(frame.picture)
    found = _fit.find_lines(seen, frame.image, parameters, on_road=is_road).shape[:, 0]
    near = OFFSETS[np.abs(OFFSETS) < 6]
    assert np.abs(found - near[:, None]).min(axis=1).max() < 0.1


def test_lines_on_flanks_are_dropped() -> None:
    parameters = settled()
    view = _fit.view_for(DRAWN, parameters)
    look = _stereo.on_road(view, parameters)
    one, two = 0, 0
    for vehicle in (lorry(3.0, -4.1), lorry(5.0, -4.1), car(6.0, 3.75)):
        frame = drawn(vehicles=(vehicle,))
        seen, is_road = look(frame.picture)
        mono = _fit.find_lines(view, frame.image, parameters)
        stereo = _fit.find_lines(seen, frame.image, parameters, on_road=is_road)

        def false(found: _fit.Found) -> int:
            return int((np.abs(found.shape[:, :1] - OFFSETS).min(axis=1) > 0.35).sum())

        one, two = one + false(mono), two + false(stereo)
    assert one >= 2
    assert two == 0


@pytest.mark.parametrize(("mono", "stereo"), [("ml", "sl"), ("mc", "sc")])
def test_on_an_empty_road_two_cameras_find_the_lines_of_one(mono: str, stereo: str) -> None:
    steps = [start(find_detector(name, {}, "x"), DRAWN) for name in (mono, stereo)]
    for k in range(K, K + 4):
        pair = drawn(k).picture
        one, two = (step(pair) for step in steps)
        assert len(one.lri) >= 2
        assert np.array_equal(two.is_continuous, one.is_continuous)
        assert two.offset_m == pytest.approx(one.offset_m, abs=0.05)


@pytest.mark.parametrize(
    ("given_", "camera", "message"),
    [
        ({"match_rows": 30}, DRAWN, "match_rows: 30 leaves 656x9 .*, and sgbm needs 64x16"),
        (
            {},
            replace(DRAWN, fx=6000.0, baseline_m=1.0),
            "baseline_m: objects 4 m ahead are .* pixels apart",
        ),
        ({}, replace(PAIR, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)), "must be rectified"),
        ({}, replace(PAIR, pitch_deg=40.0), r"camera: only 0 % of the road .*pitch_deg 40"),
    ],
)
def test_parameters_and_cameras_that_cannot_be_matched_are_named(
    given_: dict[str, object], camera: Camera, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        start(find_detector("sl", given_, "detector"), camera)


def test_a_picture_without_its_pair_is_named() -> None:
    detector = find_detector("sl", {}, "detector")
    message = "detector: sl: frame 7: the picture of the second camera is missing"
    with pytest.raises(InputError, match=message):
        list(detect(detector, DRAWN, [Picture(7, drawn().image)]))
