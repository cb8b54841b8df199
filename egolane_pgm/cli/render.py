"""`egolane simulate --images`: a rendered drive as pictures or video, with its truth."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from egolane_pgm.simulation.rendering.render import Frame, Scene

_README = """A rendered drive: {n_frames} frames of {width}x{height} pixels, {rate:g} per second,
preset {preset}, seed {seed}.

    egolane detect {pictures} --camera camera.yaml --detector {detector} -o lines.parquet
    egolane run experiment.yaml

camera.yaml: the camera at rest (its pitch oscillates about it). ground_truth.txt: the lane.
lines_truth.parquet: the lane lines as a perfect detector would see them. visibility.csv: per frame
and line its shape y(x) = offset_m + heading x + curvature x^2/2 + curvature_rate x^3/6, and the
shares of its marking between 6 and 25 m ahead that can be seen well, that are worn, hidden (or out
of the picture) and in shadow; is_failing: in a burst of failures; pitch_deg of the camera.
"""

#: From so many frames on it is said beforehand what they cost, measured on a drive of so many.
_SAID_FROM = 100

_COLUMNS = (
    "frame_id,line,offset_m,heading,curvature,curvature_rate,is_continuous,visible,worn,hidden,"
    "shaded,is_failing,pitch_deg\n"
)


def write_images(
    preset: str,
    folder: Path,
    seed: int,
    frames: int | None,
    overrides: Mapping[str, Any],
    *,
    stereo: bool,
    video: bool,
    png: bool,
) -> None:
    """Render a drive into a folder, one frame in memory at a time.

    Raises InputError for what cannot be simulated, for a folder that has pictures already, or
    where something cannot be written; the frames rendered until then, or until Ctrl-C, are kept.
    """
    from tqdm import tqdm

    from egolane_pgm.camera.model import write_camera
    from egolane_pgm.camera.writing import NotKeptError
    from egolane_pgm.recordings.ground_truth import write_ground_truth
    from egolane_pgm.recordings.table import write_table
    from egolane_pgm.results import make_directory
    from egolane_pgm.simulation.rendering.files import picture_writer
    from egolane_pgm.simulation.rendering.render import (
        check_settings,
        make_scene,
        render_frame,
        true_lines,
    )
    from egolane_pgm.types import InputError

    check_settings(overrides)
    names = ["left", "right"] if stereo else ["images"]
    places = [f"{name}.mp4" for name in names] if video else names
    for place in places:
        # Those of another drive would be read with the new ones as one.
        if (folder / place).is_dir() and any((folder / place).iterdir()):
            raise InputError(f"{folder / place}: is not empty; name another folder (--out)")
    _say_cost(preset, seed, frames, overrides, folder, stereo=stereo, video=video, png=png)
    scene = make_scene(preset, seed, frames, stereo=stereo, **overrides)
    make_directory(folder)
    write_camera(folder / "camera.yaml", scene.camera, f"rendered drive {preset}, seed {seed}")
    write_ground_truth(folder / "ground_truth.txt", scene.road.truth)
    write_table(folder / "lines_truth.parquet", true_lines(scene))
    n_rendered, rate = 0, scene.road.frame_rate
    try:
        _write_texts(folder, scene, preset, seed, places)
        with contextlib.ExitStack() as files:
            # Row by row on the disk, as the pictures are.
            table = (folder / "visibility.csv").open("w", encoding="ascii", buffering=1)
            files.enter_context(table).write(_COLUMNS)
            writers = [
                files.enter_context(picture_writer(folder / p, scene.camera, rate, png))
                for p in places
            ]
            for k in tqdm(range(len(scene)), unit="frame", disable=None):
                frame = render_frame(scene, k)
                for write, image in zip(writers, (frame.image, frame.right), strict=False):
                    if image is not None:
                        write(k, image)
                table.write(_rows(frame))
                n_rendered = k + 1
    except NotKeptError:
        raise
    except (OSError, InputError) as error:
        _remove_half(folder, places, n_rendered)
        said = str(error)
        if isinstance(error, OSError):
            said = f"{folder}: cannot be written: {error.strerror or error}"
        raise InputError(f"{said}; {n_rendered} of {len(scene)} frames are in {folder}") from error
    except KeyboardInterrupt:
        _remove_half(folder, places, n_rendered)
        click.echo(
            f"egolane: interrupted; {n_rendered} of {len(scene)} frames are in {folder}", err=True
        )
        click.get_current_context().exit(130)
    click.echo(f"{len(scene)} frames in {folder}; see {folder / 'README.md'}")


def _say_cost(
    preset: str,
    seed: int,
    frames: int | None,
    overrides: Mapping[str, Any],
    folder: Path,
    *,
    stereo: bool,
    video: bool,
    png: bool,
) -> None:
    """Say how much disk and time a drive will take; InputError where the disk has too little."""
    import shutil
    from dataclasses import replace

    from egolane_pgm.simulation.presets import PRESETS
    from egolane_pgm.simulation.rendering.files import cost_per_frame
    from egolane_pgm.simulation.rendering.render import make_scene
    from egolane_pgm.types import InputError

    if preset not in PRESETS:
        return  # refused later
    world = replace(PRESETS[preset].world)
    n_frames = frames if frames is not None else overrides.get("n_frames", world.n_frames)
    # Checked before it is counted with.
    n_frames = replace(world, n_frames=n_frames).n_frames
    if n_frames < _SAID_FROM:
        return
    settings = {key: value for key, value in overrides.items() if key != "n_frames"}
    short = make_scene(preset, seed, _SAID_FROM, stereo=stereo, **settings)
    seconds, size = cost_per_frame(short, png=png, video=video)
    nearest = folder.absolute()
    while not nearest.exists():
        nearest = nearest.parent
    disk = shutil.disk_usage(nearest)
    need = f"{n_frames} frames need about {_amount(n_frames * size)}"
    if disk.total and n_frames * size > disk.free:
        raise InputError(
            f"{folder}: {need}, the disk has {_amount(disk.free)} left; ask for fewer (--frames)"
            " or name another place (--out)"
        )
    click.echo(f"{need} and {_duration(n_frames * seconds)}; Ctrl-C keeps those rendered", err=True)


def _amount(n_bytes: float) -> str:
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{max(1, round(n_bytes / 1e6))} MB"


def _duration(seconds: float) -> str:
    for unit, name in ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{max(1, round(seconds))} seconds"


def _remove_half(folder: Path, places: list[str], frame: int) -> None:
    """A frame of which one picture of a pair was written, or its row was not."""
    for place in places:
        for file in (folder / place).glob(f"{frame:06d}.*"):
            with contextlib.suppress(OSError):
                file.unlink()


def _write_texts(folder: Path, scene: Scene, preset: str, seed: int, places: list[str]) -> None:
    import yaml

    pictures = places[0] if len(places) == 1 else f"{places[0]} --right {places[1]}"
    readme = _README.format(
        n_frames=len(scene),
        width=scene.camera.width,
        height=scene.camera.height,
        rate=scene.road.frame_rate,
        preset=preset,
        seed=seed,
        pictures=pictures,
        detector="ml" if len(places) == 1 else "sl",
    )
    (folder / "README.md").write_text(readme, encoding="ascii")
    experiment = {
        "name": f"rendered_{preset}_{seed}",
        "recording": {"path": "lines.parquet"},
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": scene.road.n_lanes,
        "tuned_on": "not_tuned",
    }
    text = yaml.safe_dump(experiment, sort_keys=False)
    (folder / "experiment.yaml").write_text(text, encoding="utf-8")


def _rows(frame: Frame) -> str:
    truth = frame.truth
    rows = []
    for line, (shape, solid) in enumerate(zip(truth.shape, truth.is_continuous, strict=True)):
        shares = (truth.visible, truth.worn, truth.hidden, truth.shaded)
        numbers = ",".join(f"{value:.6g}" for value in shape)
        rest = ",".join(f"{share[line]:.3f}" for share in shares)
        rows.append(
            f"{frame.frame_id},{line + 1},{numbers},{int(solid)},{rest},"
            f"{int(truth.is_failing)},{truth.camera.pitch_deg:.4f}\n"
        )
    return "".join(rows)
