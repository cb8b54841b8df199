"""Lines that people have labelled, in TuSimple's format (one JSON object per frame and line)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.calibration.straight_road import SeenRoad, view_of_road
from egolane_pgm.vision.camera.model import Camera, image_to_road
from egolane_pgm.vision.camera.pictures import read_image, size_of
from egolane_pgm.vision.formats.tusimple import entry_lines, read_entries

#: Labels reach to the horizon, where a pixel is many metres.
_FARTHEST_M = 40.0


def read_labels(path: str | Path) -> list[dict[str, Any]]:
    """Reads a file of TuSimple labels (`formats.tusimple`): one mapping per frame, checked.
    Only places of lines are needed here, so their classes are left out, right or wrong.

    Raises InputError for a file without frames, and one that names the line of a bad entry.
    """
    path = Path(path)
    frames = []
    for where, entry in read_entries(path):
        entry.pop("classes", None)
        entry_lines(entry, where)
        frames.append(entry)
    if not frames:
        raise InputError(f"{path}: holds no labelled frame")
    return frames


def line_points(frame: dict[str, Any]) -> list[FloatArray]:
    """The points (N, 2) of each line of a frame, pixels."""
    return [np.stack([line.u, line.v], axis=-1) for line in entry_lines(frame, "labels")]


def label_places(camera: Camera, frame: dict[str, Any], ahead_m: float) -> FloatArray:
    """Where the labelled lines of a frame lie on the road, (A,), metres to the right.

    A label's points are brought onto the road and joined by straight lines. A label that ends
    before `ahead_m` is continued by the straight line through the six nearest points; one with
    fewer than three points on the nearer 40 m of the road is left out.

    - ahead_m: the distance ahead, metres, of the places
    """
    places = []
    for points in line_points(frame):
        x, y = image_to_road(camera, points[:, 0], points[:, 1])
        seen = np.isfinite(x) & (x < _FARTHEST_M)
        x, y = x[seen], y[seen]
        if len(x) < 3:
            continue
        order = np.argsort(x)
        if x.min() <= ahead_m <= x.max():
            places.append(float(np.interp(ahead_m, x[order], y[order])))
        else:
            nearest = np.argsort(np.abs(x - ahead_m))[:6]
            fitted = np.polyfit(x[nearest], y[nearest], 1)
            places.append(float(np.polyval(fitted, ahead_m)))
    return np.array(places, dtype=np.float64)


def label_picture(frame: dict[str, Any], labels: Path) -> Path:
    """The picture of a labelled frame, in the folder of the label file. TuSimple's label files name
    pictures in `clips/`; the file may also lie in that folder itself.

    Raises InputError if the frame names no picture, or the picture is not there.
    """
    for key in ("image", "raw_file"):
        name = frame.get(key)
        if isinstance(name, str):
            for place in (labels.parent / name, labels.parent / name.removeprefix("clips/")):
                if place.is_file():
                    return place
    named = frame.get("image", frame.get("raw_file"))
    if not isinstance(named, str):
        raise InputError(f"{labels}: a frame names no image; give its size, e.g. 1280x720")
    raise InputError(
        f"{labels.parent / named}: the image of a label is missing; give its size, e.g. 1280x720"
    )


def view_from_labels(
    camera: Camera,
    path: str | Path,
    first: int | None,
    lane_width_m: float,
    progress: Callable[[Sequence[Sequence[FloatArray]]], Iterable[Sequence[FloatArray]]] = iter,
) -> SeenRoad:
    """Finds how a camera looks at the road of labelled frames.

    - camera: its lens, and where it is mounted
    - path: the label file; `first`: use only its first frames, this many; None for all
    - progress: wraps the frames while they are fitted, e.g. tqdm

    Raises InputError as `read_labels` and `view_of_road` do.
    """
    path = Path(path)
    labels = read_labels(path)[:first]
    frames = [line_points(frame) for frame in labels]
    view = view_of_road(camera, frames, lane_width_m, str(path), progress)
    n_lines = sum(len(lines) for lines in frames)
    which = f"the first {len(labels)}" if first else f"{len(labels)}"
    what = f"{n_lines} lines of {which} labelled frames of {path.name}"
    pictures = [_picture_or_none(frame, path) for frame in labels]
    return SeenRoad(view, what, tuple(zip(pictures, frames, strict=True)))


def _picture_or_none(frame: dict[str, Any], labels: Path) -> Path | None:
    try:
        return label_picture(frame, labels)
    except InputError:
        return None


def check_size(size: tuple[int, int], frames: list[dict[str, Any]], labels: Path) -> None:
    """Checks a picture's width and height, given by the user, against the labels.

    Raises InputError if the first picture found has another size, or if a line has points below
    the last row of such a picture.
    """
    width, height = size
    for frame in frames:
        try:
            picture = label_picture(frame, labels)
            seen = size_of(read_image(picture))
        except InputError:
            continue
        if seen != size:
            raise InputError(f"size: {picture} is {seen[0]}x{seen[1]}, not {width}x{height}")
        break
    lowest = max((line.v.max() for f in frames for line in entry_lines(f, "labels")), default=0.0)
    if lowest > height:
        raise InputError(
            f"size: the lines of {labels} reach down to row {lowest:.0f}, below a picture of"
            f" {width}x{height}"
        )


def size_of_pictures(frames: list[dict[str, Any]], labels: Path) -> tuple[int, int]:
    """Width and height of the pictures of labelled frames.

    Raises InputError if a picture is missing, or if they differ in size.
    """
    sizes: dict[tuple[int, int], Path] = {}
    for frame in frames:
        picture = label_picture(frame, labels)
        sizes.setdefault(size_of(read_image(picture)), picture)
    if len(sizes) > 1:
        said = ", ".join(f"{path} {w}x{h}" for (w, h), path in list(sizes.items())[:2])
        raise InputError(f"{labels}: its pictures differ in size: {said}")
    return next(iter(sizes))
