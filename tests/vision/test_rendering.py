"""The rendered motorway: its geometry, its truth, and that each frame can be rendered by itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from egolane_pgm.simulation.presets import PRESETS
from egolane_pgm.simulation.world import simulate_road
from egolane_pgm.types import FloatArray, InputError, IntArray
from egolane_pgm.vision.camera.model import Camera, axes, road_to_image
from egolane_pgm.vision.rendering import road as roads
from egolane_pgm.vision.rendering import traffic as traffics
from egolane_pgm.vision.rendering.render import frame_truth, line_y, render_frame, true_lines
from egolane_pgm.vision.rendering.road import ITALIAN, SPANISH, Markings
from egolane_pgm.vision.rendering.scene import FAILURES, Scene, make_scene
from egolane_pgm.vision.rendering.traffic import Traffic

CLEAR: dict[str, float] = dict.fromkeys(FAILURES, 0.0)


@cache
def clear_scene(preset: str = "a4", stereo: bool = False, **more: float) -> Scene:
    return make_scene(preset, 3, 200, stereo=stereo, **{**CLEAR, **more})


def with_vehicle(scene: Scene, x_m: float, d_m: float, length_m: float, height_m: float) -> Scene:
    """The scene with one grey lorry, standing still relative to the car, and nothing else."""
    one = Traffic(
        np.array([[-1e3, 0.0, 1e3, 2e3]]),
        np.full((1, 4), x_m),
        np.array([d_m]),
        np.array([length_m]),
        np.array([2.5]),
        np.array([height_m]),
        np.array([[240.0, 240.0, 240.0]]),
        np.array([True]),
    )
    return replace(scene, traffic=one)


def paint(light: Any) -> FloatArray:
    """How much brighter than the road beside it each pixel of a piece of a row is."""
    base = np.percentile(light, 15)
    return np.where(light > base + 45, light - base, 0.0)


def painted_middles(
    image: Any, camera: Camera, y: FloatArray, x: FloatArray, width_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For rows where a line's paint is: the row, its middle in the picture, where it should be."""
    u, v = road_to_image(camera, x, y)
    rows = np.arange(int(np.ceil(v[-1])), int(min(np.floor(v[0]), camera.height - 1)))
    should = np.interp(rows, v[::-1], u[::-1])
    half = camera.fx * width_m / 2 / np.interp(rows, v[::-1], x[::-1])
    found = []
    for row, middle, reach in zip(rows, should, half, strict=True):
        columns = np.arange(int(middle - reach - 6), int(middle + reach + 8))
        if columns[0] < 0 or columns[-1] >= camera.width:
            continue
        weight = paint(image[row, columns, 1])
        # Rows at the end of a dash have little paint, and concrete is bright.
        if weight.sum() > 0.6 * 110 * 2 * reach:
            found.append((row, (weight * columns).sum() / weight.sum(), middle))
    table = np.array(found).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]


@pytest.mark.parametrize("preset", ["a4", "a2"])
@pytest.mark.parametrize("yaw_deg", [0.0, 2.0])
def test_a_line_is_in_the_picture_where_the_camera_says_it_is(preset: str, yaw_deg: float) -> None:
    scene = clear_scene(preset)
    scene = replace(scene, camera=replace(scene.camera, yaw_deg=yaw_deg))
    seen = 0
    x = np.linspace(5, 25, 400)
    for k in (3, 77, 150):
        frame = render_frame(scene, k)
        y = line_y(scene, k, x)
        for line in range(len(y)):
            width = float(scene.lines.width_m[line])
            _, middle, should = painted_middles(frame.image, frame.truth.camera, y[line], x, width)
            seen += len(middle)
            if len(middle):
                assert np.abs(middle - should).max() < 1.0
                assert abs((middle - should).mean()) < (0.3 if len(middle) > 8 else 0.6)
    assert seen > 300


def test_the_truth_of_a_line_is_the_line_that_is_drawn() -> None:
    scene = clear_scene()
    x = np.linspace(0, 25, 50)
    for k in (0, 60, 199):
        truth = frame_truth(scene, k)
        s0, s1, s2, s3 = truth.shape.T[:, :, None]
        cubic = s0 + s1 * x + s2 * x**2 / 2 + s3 * x**3 / 6
        assert np.abs(cubic - line_y(scene, k, x)).max() < 0.01
        np.testing.assert_allclose(truth.offset_m, line_y(scene, k, np.zeros(1))[:, 0])


def test_the_course_is_the_integral_of_its_curvature() -> None:
    course = roads.make_course(np.random.default_rng(5), 3000.0, 1 / 500)
    s = np.arange(0.0, 2500.0, 0.5)
    side, heading, curvature, _ = course.at(s)
    np.testing.assert_allclose(np.gradient(heading, s)[1:-1], curvature[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(side, s)[1:-1], heading[1:-1], atol=1e-3)
    assert 1 / 2000 < np.abs(curvature).max() <= 1 / 500
    assert np.abs(course.bend(700.0, np.array([0.0]))).max() == 0


def test_it_is_the_drive_of_the_line_level_simulation() -> None:
    scene = clear_scene("a2")
    road = simulate_road(replace(PRESETS["a2"].world, n_frames=200), 3)
    truths = [frame_truth(scene, k) for k in range(0, 200, 20)]
    assert [t.lane for t in truths] == list(road.lane[::20])
    assert [t.is_crossing for t in truths] == list(road.is_crossing[::20])
    np.testing.assert_array_equal([t.offset_m for t in truths], road.line_offset_m[::20])
    log = true_lines(scene)
    np.testing.assert_array_equal(log.offset_m, road.line_offset_m)
    assert log.is_valid.all()
    assert list(log.is_continuous[0]) == [True, False, False, True]


def test_the_heading_is_the_slope_of_the_drive() -> None:
    scene = make_scene("a4", 1, 300, **CLEAR, wander_m=0.0, changes_per_minute=8.0)
    moving = np.gradient(scene.road.position_m) / np.gradient(scene.s_m)
    assert np.abs(moving).max() > 0.02
    # The car's body follows a little softer than the line-level drive turns.
    assert np.abs(-scene.heading - moving).mean() < 0.002
    assert np.corrcoef(-scene.heading, moving)[0, 1] > 0.97


def test_a_frame_can_be_made_by_itself_and_again() -> None:
    first = make_scene("a4", 11, 60)
    pictures = [render_frame(first, k).image for k in (20, 41)]
    again = make_scene("a4", 11, 60)
    np.testing.assert_array_equal(render_frame(again, 41).image, pictures[1])
    np.testing.assert_array_equal(render_frame(first, 20).image, pictures[0])
    assert (render_frame(make_scene("a4", 12, 60), 41).image != pictures[1]).mean() > 0.2


@pytest.mark.parametrize(("markings", "dash_m", "gap_m"), [(ITALIAN, 4.5, 7.5), (SPANISH, 5, 12)])
def test_dashes_are_as_long_as_the_country_wants(
    markings: Markings, dash_m: float, gap_m: float
) -> None:
    scene = make_scene("a4", 3, 40, markings=markings, curvature=0.0, **CLEAR)
    x = np.arange(5.0, 26.0, 0.05)
    places, light = [], []
    line = int(np.argmin(np.abs(scene.road.line_offset_m[0, 1:-1]))) + 1
    for k in range(0, 40, 3):
        frame = render_frame(scene, k)
        u, v = road_to_image(frame.truth.camera, x, line_y(scene, k, x)[line])
        places.append(scene.s_m[k] + x)
        light.append(frame.image[np.round(v).astype(int), np.round(u).astype(int), 1])
    s, is_paint = np.concatenate(places), np.concatenate(light) > 150
    bins = np.floor(s / 0.1).astype(int)
    share = np.bincount(bins, is_paint) / np.maximum(np.bincount(bins), 1)
    turns = np.flatnonzero(np.diff(share[np.bincount(bins) > 0] > 0.5)) * 0.1
    lengths = np.diff(turns)[:6]
    # A row covers up to half a metre of road at the far end.
    np.testing.assert_allclose(np.sort(lengths)[:2], dash_m, atol=0.45)
    np.testing.assert_allclose(np.sort(lengths)[-2:], gap_m, atol=0.45)
    on = scene.lines.is_dash(1, np.arange(0, 1200 * (dash_m + gap_m), 0.01))
    assert on.mean() == pytest.approx(dash_m / (dash_m + gap_m), abs=1e-3)


def test_the_share_of_paint_in_a_stretch_is_that_of_its_points() -> None:
    lines = roads.make_lines(np.random.default_rng(0), 3, 3.5, ITALIAN)
    rng = np.random.default_rng(1)
    near = rng.uniform(0, 500, 200)
    far = near + rng.uniform(0.01, 30, 200)
    share = lines.dash_share(1, near, far)
    for a, b, expected in zip(near, far, share, strict=True):
        assert lines.is_dash(1, np.linspace(a, b, 4001)).mean() == pytest.approx(expected, abs=2e-3)
    assert (lines.dash_share(0, near, far) == 1).all()


def test_wear_is_the_share_of_paint_that_is_gone() -> None:
    lines = roads.make_lines(np.random.default_rng(0), 3, 3.5, ITALIAN)
    s, across = np.arange(0, 200, 0.05)[:, None], np.linspace(0.05, 0.95, 8)
    for level in (0.0, 0.3, 0.8, 1.0):
        left = lines.paint(2, s, across, np.array(level))
        assert left.mean() == pytest.approx(1 - level, abs=0.02)


def test_nothing_is_in_the_way_on_a_clear_road() -> None:
    truth = frame_truth(clear_scene(), 50)
    near = np.abs(truth.offset_m) < 5
    assert (truth.visible[near] == 1).all()
    assert not truth.worn.any()
    assert not truth.shaded.any()
    assert not truth.is_failing


def test_a_line_without_paint_is_not_visible() -> None:
    scene = make_scene("a4", 3, 20, **{**CLEAR, "wear": 1.0, "calm": 1.0})
    truth = frame_truth(scene, 10)
    assert (truth.worn == 1).all()
    assert not truth.visible.any()
    frame = render_frame(scene, 10)
    x = np.linspace(5, 25, 400)
    for line, y in enumerate(line_y(scene, 10, x)):
        width = float(scene.lines.width_m[line])
        assert not len(painted_middles(frame.image, truth.camera, y, x, width)[0])


def test_a_line_behind_a_lorry_is_not_visible() -> None:
    scene = clear_scene()
    k = int(np.flatnonzero(scene.road.lane <= 3)[0])
    lane = int(scene.road.lane[k])
    # In the lane to the right, from behind the car to far ahead: all lines beyond are hidden.
    middle = (lane + 0.5) * PRESETS["a4"].world.lane_width_m
    blocked = frame_truth(with_vehicle(scene, -5.0, middle, 60.0, 4.0), k)
    free = frame_truth(scene, k)
    assert (blocked.hidden[lane + 1 :] == 1).all()
    assert not blocked.visible[lane + 1 :].any()
    np.testing.assert_array_equal(blocked.visible[:lane], free.visible[:lane])


def test_the_shadow_of_the_barrier_lies_on_the_leftmost_line() -> None:
    scene = clear_scene()
    surface = replace(scene.surface, reach_m=np.full_like(scene.surface.reach_m, 2.0))
    dark = replace(scene, surface=surface)
    k = int(np.argmax(scene.road.line_offset_m[:, 0]))
    truth = frame_truth(dark, k)
    assert truth.shaded[0] == 1
    assert truth.visible[0] == 0
    assert not truth.shaded[1:].any()
    x = np.linspace(8, 20, 100)
    u, v = road_to_image(truth.camera, x, line_y(scene, k, x)[0])
    at = (np.round(v).astype(int), np.round(u).astype(int), 1)
    before, after = render_frame(scene, k).image[at], render_frame(dark, k).image[at]
    assert after.mean() < 0.6 * before.mean()


def test_leaves_shade_the_share_of_the_road_that_they_should() -> None:
    surface = clear_scene().surface
    s, d = np.arange(0, 200, 0.2)[:, None], np.linspace(0, 3, 10)[None, :]
    assert surface.shadow(s, d).max() == 0
    trees = replace(surface, leaves=np.full_like(surface.leaves, 0.8))
    share = 0.8 * (d + 6) / (surface.right_m + 6)
    assert (trees.shadow(s, d) > 0.5).mean() == pytest.approx(share.mean() - 0.06, abs=0.08)


@pytest.mark.parametrize("yaw_deg", [0.0, 2.0])
def test_the_second_picture_is_shifted_by_the_disparity(yaw_deg: float) -> None:
    scene = clear_scene("a4", stereo=True)
    scene = replace(scene, camera=replace(scene.camera, yaw_deg=yaw_deg))
    k, x = 20, np.linspace(5, 22, 400)
    frame = render_frame(scene, k)
    camera = frame.truth.camera
    assert frame.right is not None
    assert camera.baseline_m is not None
    right, _, forward = axes(camera)
    shift = camera.baseline_m * right
    checked = 0
    for line, y in enumerate(line_y(scene, k, x)):
        width = float(scene.lines.width_m[line])
        rows, left_u, _ = painted_middles(frame.image, camera, y, x, width)
        # The second camera sees the line where the first would see it if it were moved.
        moved = road_to_image(camera, x - shift[0], y - shift[1])
        both = np.flatnonzero(
            (moved[0] > 20) & (moved[0] < camera.width - 20) & (moved[1] < camera.height - 1)
        )
        for row, at_left in zip(rows, left_u, strict=True):
            should = np.interp(row, moved[1][both][::-1], moved[0][both][::-1])
            near = np.arange(int(should) - 22, int(should) + 23)
            if near[0] < 0 or near[-1] >= camera.width:
                continue
            weight = paint(frame.right[int(row), near, 1])
            if not weight.sum():
                continue
            distance = np.interp(row, moved[1][both][::-1], x[both][::-1])
            depth = distance * forward[0] - camera.height_m * forward[2]
            if not yaw_deg:
                disparity = at_left - (weight * near).sum() / weight.sum()
                assert disparity == pytest.approx(camera.fx * camera.baseline_m / depth, abs=0.8)
            assert (weight * near).sum() / weight.sum() == pytest.approx(should, abs=1.0)
            checked += 1
    assert checked > 100


def test_a_vehicle_has_the_disparity_of_its_distance() -> None:
    scene = clear_scene("a4", stereo=True)
    k, at_m = 20, 18.0
    position = float(scene.road.position_m[k])
    there = with_vehicle(scene, at_m, position + 0.3, 8.0, 3.5)
    frame, empty = render_frame(there, k), render_frame(scene, k)
    camera = frame.truth.camera
    row = int(road_to_image(camera, at_m, 0.0, 2.0)[1])
    edges = []
    for with_it, without in ((frame.image, empty.image), (frame.right, empty.right)):
        assert with_it is not None
        assert without is not None
        changed = np.abs(with_it[row].astype(int) - without[row].astype(int)).max(axis=1) > 12
        columns = np.flatnonzero(changed)
        edges.append((columns[0] + columns[-1]) / 2)
        width = camera.fx * 2.5 / at_m
        assert columns[-1] - columns[0] == pytest.approx(width, abs=0.06 * width + 2)
    assert camera.baseline_m is not None
    assert edges[0] - edges[1] == pytest.approx(camera.fx * camera.baseline_m / at_m, abs=1.5)


def test_each_failure_does_what_it_says_and_only_then() -> None:
    calm = {"calm": 1.0, "bad_s": 0.0}
    plain = render_frame(clear_scene(), 30)

    def failing(name: str) -> Scene:
        return make_scene("a4", 3, 200, **{**CLEAR, **calm, name: 1.0})

    sky = (slice(0, 60), slice(None), 1)
    noisy = render_frame(failing("noise"), 30).image[sky]
    assert noisy.astype(float).std() > 3 * plain.image[sky].astype(float).std()
    glaring = render_frame(failing("glare"), 30).image
    assert (glaring > 250).mean() > 0.01 > (plain.image > 250).mean()
    pitching = failing("pitch")
    pitch = [frame_truth(pitching, k).camera.pitch_deg for k in range(0, 200, 5)]
    assert 0.2 < np.std(pitch) < 1.5
    assert len(failing("occlusion").traffic) > 3
    assert not len(clear_scene().traffic)
    assert failing("shadow").surface.leaves.max() > 0.5
    assert not clear_scene().pitch_deg.any()


def test_bursts_are_of_one_kind_at_a_time() -> None:
    scene = make_scene("a4", 2, 1500, ok_s=5.0, bad_s=5.0, glare=0.0)
    strong = np.stack([scene.level[name] > 0.5 for name in FAILURES])
    assert (strong.sum(axis=0) == scene.is_failing).all()
    assert 0.2 < scene.is_failing.mean() < 0.8
    assert not strong[FAILURES.index("glare")].any()
    assert strong.any(axis=1).sum() >= 4


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"preset": "a5"}, "unknown preset 'a5'"),
        ({"waer": 0.5}, "unknown key 'waer' (did you mean 'wear'?)"),
        ({"wear": 1.5}, "simulation.wear: 1.5 is not a probability"),
        ({"ok_s": 0}, "simulation.ok_s: 0 must be greater than 0"),
        ({"speed_mps": 300}, "simulation.speed_mps: 300.0 is above 80"),
        ({"speed_mps": "fast"}, "simulation.speed_mps: 'fast' is not a number"),
        ({"curvature": 0.1}, "simulation.curvature: 0.1 is above 1/300"),
        ({"frames": 0}, "simulation.n_frames: 0"),
        ({"camera": Camera(640, 480, 500, 500, 320, 200, 1.5, roll_deg=1.0)}, "roll_deg"),
        ({"camera": Camera(640, 480, 500, 500, 320, 800, 1.5)}, "does not see the road"),
    ],
)
def test_what_cannot_be_rendered_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as error:
        make_scene(**{"preset": "a4", "seed": 0, "frames": 20, **change})
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_markings_and_frames_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="gap_m"):
        Markings(4.5, 0.0, 0.15, 0.25)
    with pytest.raises(InputError, match="at most 1 m wide"):
        Markings(4.5, 7.5, 15.0, 0.25)
    for k in (-1, 200):
        with pytest.raises(InputError, match=f"frame {k} is outside 0..199"):
            render_frame(clear_scene(), k)


def test_vehicles_keep_clear_of_each_other_as_a_search_over_all_frames_finds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = traffics._possible
    n_kept = []

    def both(traffic: Any, time_s: Any, position_m: Any) -> IntArray:
        found = real(traffic, time_s, position_m)
        assert found.tolist() == plainly_possible(traffic, time_s, position_m)
        n_kept.append(len(found))
        return found

    monkeypatch.setattr(traffics, "_possible", both)
    for seed in range(3):
        make_scene("a4", seed, 1500)
    make_scene("a4", 0, 1)
    assert min(n_kept[:3]) > 5


def plainly_possible(traffic: Any, time_s: Any, position_m: Any) -> list[int]:
    kept: list[tuple[int, Any]] = []
    for k in range(len(traffic)):
        rear = np.interp(time_s[::3], traffic.time_s[k], traffic.x_m[k], left=np.nan, right=np.nan)
        front = rear + traffic.length_m[k]
        is_beside = np.abs(traffic.d_m[k] - position_m[::3]) < 2.9
        is_clear = not (is_beside & (front > -6) & (rear < 8)).any()
        for j, other in kept:
            if abs(traffic.d_m[j] - traffic.d_m[k]) < 2:
                far = other + traffic.length_m[j] + 4
                is_clear &= not ((rear < far) & (front > other - 4)).any()
        if is_clear:
            kept.append((k, rear))
    return [k for k, _ in kept]
