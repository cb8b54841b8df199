"""Writes a rendered drive to a folder: pictures or a video, and the truth about every line."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tools.files import make_directory, write_text, write_yaml
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import write_camera
from egolane_pgm.vision.camera.writing import frame_writer
from egolane_pgm.vision.rendering.render import Frame, render_frame, true_lines
from egolane_pgm.vision.rendering.scene import Scene

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

_COLUMNS = (
    "frame_id,line,offset_m,heading,curvature,curvature_rate,is_continuous,visible,worn,hidden,"
    "shaded,is_failing,pitch_deg\n"
)


def free_places(folder: Path, *, stereo: bool, video: bool) -> list[str]:
    """The names that the pictures get in a folder, the left camera's first.

    Raises InputError if one of these folders has files already, because those of another drive
    would be read together with the new ones.
    """
    names = ["left", "right"] if stereo else ["images"]
    places = [f"{name}.mp4" for name in names] if video else names
    for place in places:
        if (folder / place).is_dir() and any((folder / place).iterdir()):
            raise InputError(f"{folder / place}: is not empty; name another folder")
    return places


def write_drive(
    scene: Scene,
    folder: Path,
    preset: str,
    seed: int,
    places: Sequence[str],
    *,
    png: bool,
    progress: Callable[[range], Iterable[int]],
) -> None:
    """Renders a drive into a folder, with one frame in memory at a time.

    - places: the names of the pictures, from `free_places`
    - png: whether pictures are PNG instead of JPEG
    - progress: wraps the frame numbers, e.g. tqdm

    Raises InputError if something cannot be written.
    """
    make_directory(folder)
    write_camera(folder / "camera.yaml", scene.camera, f"rendered drive {preset}, seed {seed}")
    write_ground_truth(folder / "ground_truth.txt", scene.road.truth)
    write_table(folder / "lines_truth.parquet", true_lines(scene))
    _write_texts(folder, scene, preset, seed, places)
    rate, size = scene.road.frame_rate, (scene.camera.width, scene.camera.height)
    name = "{:06d}.png" if png else "{:06d}.jpg"
    n_rendered = 0
    try:
        with contextlib.ExitStack() as files:
            table = files.enter_context((folder / "visibility.csv").open("w", encoding="ascii"))
            table.write(_COLUMNS)
            writers = [
                files.enter_context(frame_writer(folder / p, rate, size, name)) for p in places
            ]
            for k in progress(range(len(scene))):
                frame = render_frame(scene, k)
                for write, image in zip(writers, (frame.image, frame.right), strict=False):
                    if image is not None:
                        write(k, image)
                table.write(_rows(frame))
                n_rendered += 1
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{n_rendered} of {len(scene)} frames are in {folder}; the same command begins anew"
        ) from None


def _write_texts(folder: Path, scene: Scene, preset: str, seed: int, places: Sequence[str]) -> None:
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
    write_text(folder / "README.md", readme)
    experiment = {
        "name": f"rendered_{preset}_{seed}",
        "recording": {"path": "lines.parquet"},
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": scene.road.n_lanes,
        "tuned_on": "not_tuned",
    }
    write_yaml(folder / "experiment.yaml", experiment)


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
