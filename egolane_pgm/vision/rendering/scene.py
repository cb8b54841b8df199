"""The scene of a rendered drive: road, failures and surroundings, prepared once for all frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from egolane_pgm.simulation._common import NotNegative, Positive, Share, check_fields, slow_noise
from egolane_pgm.simulation.detector import DetectorModel, sensor_failures
from egolane_pgm.simulation.presets import PRESETS
from egolane_pgm.simulation.world import Road, World, simulate_road
from egolane_pgm.types import BoolArray, FloatArray, InputError, suggestion
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.rendering import road as roads
from egolane_pgm.vision.rendering import surface as surfaces
from egolane_pgm.vision.rendering import traffic as traffics


@dataclass(frozen=True)
class Failures:
    """How strongly each kind of failure hides lines, from 0 (not at all) to 1.

    - occlusion: by cars and lorries
    - wear: of the paint
    - shadow: of barriers, trees and bridges
    - pitch: oscillation of the camera, up to about 2 degrees
    - noise: of the sensor
    - glare: of a low sun
    - calm: share of these strengths outside bursts; each burst has one kind at full strength
    - ok_s, bad_s: mean time between bursts, and of a burst, seconds; bad_s = 0 for no bursts

    Raises InputError, naming the key, for a value out of range.
    """

    occlusion: Share = 0.8
    wear: Share = 0.8
    shadow: Share = 0.8
    pitch: Share = 0.7
    noise: Share = 0.7
    glare: Share = 0.7
    calm: Share = 0.3
    ok_s: Positive = 20.0
    bad_s: NotNegative = 4.0

    def __post_init__(self) -> None:
        check_fields(self)


#: The kinds of failure, in the order in which results list them.
FAILURES = ("occlusion", "wear", "shadow", "pitch", "noise", "glare")

#: The camera and the markings of each preset. The pictures have the paper's sizes; the paper states
#: neither focal lengths nor heights, and these cameras see a lane to each side from 7 m ahead.
CAMERAS: Mapping[str, Camera] = {
    "a4": Camera(1312, 540, 760.0, 760.0, 655.5, 215.0, 1.5, pitch_deg=-1.0),
    "a2": Camera(1392, 400, 820.0, 820.0, 695.5, 150.0, 1.4, pitch_deg=-1.0),
    "quickstart": Camera(1312, 540, 760.0, 760.0, 655.5, 215.0, 1.5, pitch_deg=-1.0),
}
MARKINGS: Mapping[str, roads.Markings] = {
    "a4": roads.ITALIAN,
    "a2": roads.SPANISH,
    "quickstart": roads.ITALIAN,
}

#: Metres between the two cameras of a pair.
BASELINE_M = 0.4


@dataclass(frozen=True)
class Motion:
    """The speed of the car, and the bends of the road.

    - speed_mps: mean speed, metres per second
    - curvature: largest curvature of the road, 1/m; 0 for a straight road

    Raises InputError, naming the key, for a value that no motorway has.
    """

    speed_mps: Positive = 29.0
    curvature: NotNegative = 1 / 1500

    def __post_init__(self) -> None:
        check_fields(self)
        if self.speed_mps > 80:
            raise InputError(f"simulation.speed_mps: {self.speed_mps} is above 80 m/s")
        if self.curvature > 1 / 300:
            raise InputError(f"simulation.curvature: {self.curvature} is above 1/300 per metre")


@dataclass(frozen=True)
class Scene:
    """A drive of T frames, ready to be rendered.

    - camera: at rest
    - road: the drive as lines
    - level: (T,) strength of each kind of failure in each frame
    - is_failing: (T,) whether a frame is in a burst
    - s_m: (T,) distance driven
    - heading: (T,) slope of the road ahead, as seen from the car, m/m
    - pitch_deg: (T,) additional pitch of the camera
    - course, lines, surface, traffic: the road's bends, its markings, its surface, other vehicles
    - tree_s_m: places of the trees along the road
    - rail_m: distance of the guard rail from the leftmost line
    - noise_tile, halo: pictures of the sensor's noise and of the light of a low sun
    """

    camera: Camera
    road: Road
    seed: int
    level: Mapping[str, FloatArray]
    is_failing: BoolArray
    s_m: FloatArray
    heading: FloatArray
    pitch_deg: FloatArray
    course: roads.Course
    lines: roads.Lines
    surface: surfaces.Surface
    traffic: traffics.Traffic
    tree_s_m: FloatArray
    rail_m: float
    noise_tile: Image
    halo: Image

    def __len__(self) -> int:
        return len(self.road)


#: The settings of a drive that `make_scene` takes by name.
SETTINGS = tuple(f.name for kind in (World, Failures, Motion) for f in fields(kind))


def check_settings(overrides: Mapping[str, Any]) -> None:
    """Raises InputError, with a suggestion, for a key that is not in `SETTINGS`."""
    for key in overrides:
        if key not in SETTINGS:
            raise InputError(f"simulation: unknown key '{key}'{suggestion(key, SETTINGS)}")


def make_scene(
    preset: str = "a4",
    seed: int = 0,
    frames: int | None = None,
    *,
    failures: Failures | None = None,
    camera: Camera | None = None,
    markings: roads.Markings | None = None,
    stereo: bool = False,
    **overrides: Any,
) -> Scene:
    """Prepares a drive for rendering.

    - preset: a name in `simulation.PRESETS`
    - frames, failures, camera, markings: replace those of the preset
    - stereo: whether there are two cameras
    - overrides: replace any of `SETTINGS`, the fields of `World`, `Failures` and `Motion`

    Raises InputError for an unknown preset or key, with a suggestion, and for a value that is out
    of range, naming the key.
    """
    if preset not in PRESETS:
        raise InputError(f"simulation: unknown preset '{preset}'{suggestion(preset, PRESETS)}")
    check_settings(overrides)
    if frames is not None:
        overrides["n_frames"] = frames

    def given(kind: type) -> dict[str, Any]:
        return {f.name: overrides[f.name] for f in fields(kind) if f.name in overrides}

    chosen = replace(PRESETS[preset].world, **given(World))
    failures = replace(failures or Failures(), **given(Failures))
    motion = Motion(**given(Motion))
    camera = camera or CAMERAS[preset]
    if stereo and camera.baseline_m is None:
        camera = replace(camera, baseline_m=BASELINE_M)
    if any(camera.distortion) or camera.roll_deg:
        raise InputError("simulation: a rendered camera has neither distortion nor roll_deg")
    if not np.isfinite(image_to_road(camera, camera.cx, 0.8 * camera.height)[0]):
        raise InputError("simulation: the camera does not see the road; check cy and pitch_deg")
    road = simulate_road(chosen, seed)

    def rng(part: int) -> np.random.Generator:
        # Each part has its own random numbers, so that a change of one leaves the others as is.
        return np.random.default_rng([seed, 3, part])

    rate, n_frames = road.frame_rate, len(road)
    drift = slow_noise(rng(0), n_frames, 1, 20 * rate)[:, 0]
    speed = motion.speed_mps * (1 + 0.05 * np.tanh(drift))
    s_m = 50.0 + np.cumsum(speed) / rate
    sideways = np.gradient(_smooth(road.position_m, 0.4 * rate)) * rate if n_frames > 1 else 0.0

    bursts = DetectorModel(ok_s=failures.ok_s, bad_s=failures.bad_s)
    is_failing = sensor_failures(bursts, road, seed)
    level, spans = _levels(rng(1), failures, is_failing)

    grid_m = np.arange(0.0, float(s_m[-1]) + 600.0, 0.5)
    shadow = np.interp(grid_m, s_m + 12.0, level["shadow"])
    lines = roads.make_lines(
        rng(2), chosen.n_lanes, chosen.lane_width_m, markings or MARKINGS[preset]
    )
    barrier_m = -1.0
    rail_m = float(lines.d_m[-1]) + (chosen.shoulder_m or 2.5)
    middles = (lines.d_m[1:] + lines.d_m[:-1]) / 2
    time_s = np.arange(n_frames) / rate
    return Scene(
        camera=camera,
        road=road,
        seed=seed,
        level=level,
        is_failing=is_failing,
        s_m=s_m,
        heading=-sideways / speed,
        pitch_deg=_pitching(rng(3), level["pitch"], rate),
        course=roads.make_course(rng(4), float(s_m[-1]) + 800.0, motion.curvature),
        lines=lines,
        surface=surfaces.make_surface(rng(5), grid_m, shadow, lines.d_m, barrier_m, rail_m),
        traffic=traffics.make_traffic(
            rng(6),
            time_s,
            road.position_m,
            middles,
            60.0 * level["occlusion"],
            [(a / rate, b / rate) for a, b in spans["occlusion"]],
        ),
        tree_s_m=np.cumsum(rng(7).uniform(5, 30, int((s_m[-1] + 600) / 17))),
        rail_m=rail_m,
        noise_tile=_noise_tile(rng(8), camera),
        halo=_halo(rng(9), camera),
    )


def _smooth(values: FloatArray, frames: float) -> FloatArray:
    """Smooths values with a Gaussian whose standard deviation is `frames`."""
    half = max(1, int(4 * frames))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(frames, 0.1)) ** 2)
    padded = np.pad(values, half, mode="edge")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"))


def _levels(
    rng: np.random.Generator, failures: Failures, is_failing: BoolArray
) -> tuple[dict[str, FloatArray], dict[str, list[tuple[int, int]]]]:
    """The level of each kind of failure in each frame, and its bursts (first frame, one after the
    last)."""
    level = {
        name: np.full(len(is_failing), failures.calm * getattr(failures, name)) for name in FAILURES
    }
    spans: dict[str, list[tuple[int, int]]] = {name: [] for name in FAILURES}
    kinds = [name for name in FAILURES if getattr(failures, name) > 0]
    turns = np.flatnonzero(np.diff(is_failing, prepend=False, append=False))
    for start, end in zip(turns[::2], turns[1::2], strict=True):
        if kinds:
            name = kinds[int(rng.integers(len(kinds)))]
            level[name][start:end] = getattr(failures, name)
            spans[name].append((int(start), int(end)))
    return level, spans


def _pitching(rng: np.random.Generator, level: FloatArray, rate: float) -> FloatArray:
    """The additional pitch in each frame, (T,), degrees: the body's oscillation on its springs, and
    the slower one of the road."""
    t = np.arange(len(level)) / rate
    swing = slow_noise(rng, len(level), 2, 1.5 * rate)
    body = swing[:, 0] * np.sin(2 * np.pi * 1.4 * t + rng.uniform(0, 6))
    return np.asarray(np.clip(level * (0.75 * body + 0.35 * swing[:, 1]), -2.0, 2.0))


def _noise_tile(rng: np.random.Generator, camera: Camera) -> Image:
    """Noise of mean 128 and standard deviation 24, larger than the picture; each frame uses another
    part of it."""
    shape = (camera.height + 128, camera.width + 128, 3)
    grain = rng.standard_normal(shape, dtype=np.float32)
    return np.clip(128 + 24 * grain, 0, 255).astype(np.uint8)


def _halo(rng: np.random.Generator, camera: Camera) -> Image:
    """The light that a low sun adds to the picture: its disc, a veil, and a bright stripe on the
    asphalt below it."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    at = camera.width * rng.uniform(0.3, 0.7), camera.cy - 0.22 * camera.height
    away = np.hypot(u - at[0], v - at[1])
    light = 255 * np.exp(-away / (0.16 * camera.width)) + 45
    light += 110 * np.exp(-0.5 * ((u - at[0]) / (0.05 * camera.width)) ** 2) * (v > camera.cy)
    tinted = light[..., None] * np.array([0.92, 0.97, 1.0])
    return np.asarray(np.clip(tinted, 0, 255), dtype=np.uint8)
