"""Writes a rendered drive to a folder: pictures or a video, and the truth about every line."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import cv2

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.tools.files import make_directory, write_text, write_yaml
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera, write_camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.writing import video_writer, write_picture
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

    The frames rendered before Ctrl-C are kept. Raises InputError if something cannot be written.
    """
    make_directory(folder)
    write_camera(folder / "camera.yaml", scene.camera, f"rendered drive {preset}, seed {seed}")
    write_ground_truth(folder / "ground_truth.txt", scene.road.truth)
    write_table(folder / "lines_truth.parquet", true_lines(scene))
    n_rendered, rate = 0, scene.road.frame_rate
    try:
        _write_texts(folder, scene, preset, seed, places)
        with contextlib.ExitStack() as files:
            # The table is line buffered, so that a row is on the disk as soon as its picture is.
            table = (folder / "visibility.csv").open("w", encoding="ascii", buffering=1)
            files.enter_context(table).write(_COLUMNS)
            writers = [
                files.enter_context(picture_writer(folder / p, scene.camera, rate, png))
                for p in places
            ]
            for k in progress(range(len(scene))):
                frame = render_frame(scene, k)
                for write, image in zip(writers, (frame.image, frame.right), strict=False):
                    if image is not None:
                        write(k, image)
                table.write(_rows(frame))
                n_rendered = k + 1
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


@contextlib.contextmanager
def picture_writer(
    place: Path, camera: Camera, frame_rate: float, png: bool
) -> Iterator[Callable[[int, Image], None]]:
    """A context that gives a function to write a frame's picture to a video (.mp4) or into a folder
    (JPEG or PNG).

    Raises InputError if something cannot be written.
    """
    if place.suffix == ".mp4":
        with video_writer(place, frame_rate, (camera.width, camera.height)) as append:
            yield lambda _, image: append(image)
        return
    make_directory(place)
    ending, options = ("png", []) if png else ("jpg", [cv2.IMWRITE_JPEG_QUALITY, 95])
    yield lambda k, image: write_picture(place / f"{k:06d}.{ending}", image, options)
