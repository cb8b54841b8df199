"""The verb `calibrate`: chessboards and roads in, a camera's YAML out."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge

from egolane_pgm.tools.files import check_not_read, check_place, temporary_folder
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, Progress, Seed, StrPath, several_of
from egolane_pgm.vision.calibration.chessboard import (
    calibrate_lens,
    check_road_size,
    describe_lens,
)
from egolane_pgm.vision.calibration.drawing import draw_view
from egolane_pgm.vision.calibration.labels import (
    check_size,
    read_labels,
    size_of_pictures,
    view_from_labels,
)
from egolane_pgm.vision.calibration.road_lines import find_in_stills, view_from_stills
from egolane_pgm.vision.calibration.straight_road import (
    ASSUMED_FIELD_OF_VIEW,
    SeenRoad,
    assumed_camera,
    check_lane_width,
    describe_assumed_lens,
    describe_view,
    doubts_of,
)
from egolane_pgm.vision.calibration.video_stills import take_stills
from egolane_pgm.vision.camera.model import Camera, write_camera
from egolane_pgm.vision.camera.pictures import (
    PICTURES,
    files_matching,
    open_source,
    read_image,
    read_images,
    size_of,
)
from egolane_pgm.vision.camera.writing import check_picture_name, write_picture

EXAMPLES = (
    "egolane calibrate --stills drive.mp4 --lane-width 3.7 -o cam.yaml",
    "egolane calibrate --chessboards 'boards/*.jpg' --stills 'road/*.jpg' --lane-width 3.7"
    " -o cam.yaml",
)

#: How many of the frames taken from a video are used.
CHOSEN = 30

Rectangle = tuple[int, int, int, int]


def calibrate(
    *,
    chessboards: Annotated[str | None, Option("GLOB")] = None,
    board: Annotated[str, Option("COLUMNSxROWS")] = "9x6",
    stills: Annotated[str | None, Option("GLOB|VIDEO")] = None,
    lines: Annotated[str | None, Option("FILE")] = None,
    lane_width: Annotated[float | None, Option("M")] = None,
    first: Annotated[int | None, Ge(1), Option("N")] = None,
    size: Annotated[str | None, Option("WxH")] = None,
    field_of_view: Annotated[float | None, Option("DEGREES")] = None,
    roll: Annotated[float, Option("DEGREES")] = 0.0,
    lateral: Annotated[float, Option("M")] = 0.0,
    baseline: Annotated[float | None, Option("M")] = None,
    ignore: Annotated[str | Sequence[str], Option("LEFT,TOP,RIGHT,BOTTOM", many=True)] = (),
    ignore_below: Annotated[int | None, Ge(1), Option("ROW")] = None,
    seed: Seed = 0,
    picture: Annotated[StrPath | None, Option("PNG")] = None,
    out: Annotated[StrPath | None, Option("FILE", names=("-o",), required=True)] = None,
    progress: Progress = None,
) -> Camera:
    """Find out how a camera sees the road: lens from chessboards, turn and height from lines.

    - chessboards: pictures of a chessboard, for the lens.
    - board: inner corners of the chessboard.
    - stills: pictures of a straight road, or a video: its lines are found.
    - lines: labelled lines instead: TuSimple JSON lines.
    - lane_width: of that road's lanes, metres.
    - first: only the first N stills or labels.
    - size: of the labelled pictures, where they are not there.
    - field_of_view: horizontal, where there are no chessboards; 62 is assumed.
    - roll: clockwise.
    - lateral: right of the vehicle's middle.
    - baseline: of a rectified stereo pair.
    - ignore: pixels that never show road (mirror, dashboard); kept in the YAML. Repeatable.
    - ignore_below: the same: bonnet.
    - seed: of the search for lines.
    - picture: draw lines, horizon and a grid of metres on a still.
    - out: the camera's YAML.
    - progress: whether bars show how far it is; None for in a terminal.

    Returns the camera, whose YAML says how it was found. Without `out` it is not written. Raises
    InputError, one line, for whatever does not fit.
    """
    masks = tuple(_rectangle(each) for each in several_of(ignore))
    of_labels = None if size is None else _size(size, "size")
    _check_places([out, picture], [chessboards, stills], [lines])
    if lane_width is None:
        raise InputError("lane_width: is missing; how wide are the lanes of the road, in metres?")
    check_lane_width(lane_width)
    if (stills is None) == (lines is None):
        raise InputError("give either stills of a road or lines with labels")
    if chessboards and field_of_view is not None:
        raise InputError("field_of_view: goes without chessboards, which measure the lens")
    if size and not lines:
        raise InputError("size: goes with lines; stills say their own size")
    if picture is not None:
        check_picture_name(str(picture))

    def shown(what: str) -> Callable[[Iterable[Any]], Iterable[Any]]:
        return partial(bar, progress=progress, desc=what, unit="picture")

    with temporary_folder() as folder:
        n_taken, pattern = 0, stills
        if stills and Path(stills).is_file() and Path(stills).suffix.lower() not in PICTURES:
            if first is not None:
                raise InputError("first: goes without a video, of which frames are chosen")
            n_taken = len(take_stills(open_source(stills), folder, shown("frames")))
            pattern = str(folder)
        known = _size_of_road(of_labels, pattern, lines, first)
        if chessboards:
            paths = shown("chessboards")(files_matching(chessboards))
            lens = calibrate_lens(paths, *_size(board, "board"))
            _warn_of(lens.skipped)
            check_road_size(lens, known)
            camera, said = lens.camera, describe_lens(lens, board)
            each = zip(lens.boards, lens.rms_px, strict=True)
            said += [f"  {name}: {rms:.2f} px RMS" for name, rms in each]
        else:
            degrees = ASSUMED_FIELD_OF_VIEW if field_of_view is None else field_of_view
            camera, said = assumed_camera(*known, degrees), describe_assumed_lens(degrees)
        camera = replace(camera, roll_deg=roll, lateral_m=lateral, baseline_m=baseline)
        camera = _masked(camera, masks, ignore_below)
        if pattern:
            stills_of = files_matching(pattern)[:first]
            most = CHOSEN if n_taken else None
            found = find_in_stills(camera, stills_of, seed, shown("stills"), most)
            _warn_of(found.skipped)
            if n_taken:
                said.append(
                    f"Stills: {len(found.paths)} of {n_taken} frames taken from {stills}, those"
                    " with the clearest straight lines."
                )
            road = view_from_stills(camera, found, lane_width)
        else:
            road = view_from_labels(camera, str(lines), first, lane_width, shown("labels"))
        said += describe_view(road.view, road.what)
        for doubt in doubts_of(road.view):
            said.append(doubt)
            warnings.warn(f"{stills or lines}: {doubt}", UserWarning, stacklevel=2)
        if roll:
            said.append(f"Roll: {roll:g} degrees, given.")
        _written(road.view.camera, said, out)
        if picture is not None:
            _draw(road, Path(picture))
    return road.view.camera


def says(done: Camera, given: Mapping[str, Any]) -> str:
    """How the camera was found, as its file says, and the files."""
    lines = Path(given["out"]).read_text(encoding="utf-8").splitlines()
    said = [line.removeprefix("# ") for line in lines if line.startswith("# ")]
    files = " and ".join(given[key] for key in ("out", "picture") if given[key])
    return "\n".join([*said[1:], f"written to {files}"])


def _written(camera: Camera, said: Sequence[str], out: StrPath | None) -> Camera:
    if out is not None:
        write_camera(Path(out), camera, "\n".join(["Made by `egolane calibrate`.", *said]))
    return camera


def _numbers(text: str, separator: str, n: int, name: str, example: str) -> tuple[int, ...]:
    parts = text.lower().split(separator)
    if len(parts) != n or not all(part.strip().isdecimal() for part in parts):
        raise InputError(f"{name}: '{text}' is not {example}")
    return tuple(int(part) for part in parts)


def _size(text: str, name: str) -> tuple[int, int]:
    width, height = _numbers(text, "x", 2, name, "two whole numbers, e.g. 1280x720")
    return width, height


def _rectangle(text: str) -> Rectangle:
    example = "left,top,right,bottom in pixels, e.g. 0,600,1280,720"
    left, top, right, bottom = _numbers(text, ",", 4, "ignore", example)
    return left, top, right, bottom


def _masked(camera: Camera, masks: tuple[Rectangle, ...], below: int | None) -> Camera:
    """The camera with the parts of its pictures that show no road. Raises InputError for one that
    is outside of them."""
    if below is not None:
        if below >= camera.height:
            raise InputError(f"ignore_below: a picture has {camera.height} rows only")
        masks = (*masks, (0, below, camera.width, camera.height))
    for mask in masks:
        if mask[0] >= camera.width or mask[1] >= camera.height:
            said = ",".join(map(str, mask))
            raise InputError(
                f"ignore: {said} is not in a picture of {camera.width}x{camera.height}"
            )
    return replace(camera, ignore=masks)


def _check_places(
    places: Sequence[StrPath | None], patterns: Sequence[str | None], files: Sequence[str | None]
) -> None:
    """Raise InputError for an output that cannot be written, or that is read."""
    read = [Path(file) for file in files if file]
    for pattern in filter(None, patterns):
        with contextlib.suppress(InputError):
            read += files_matching(pattern)
    for place in [Path(place) for place in places if place is not None]:
        check_not_read(place, [each for each in read if each.name == place.name])
        check_place(place)


def _size_of_road(
    given: tuple[int, int] | None, stills: str | None, lines: str | None, first: int | None
) -> tuple[int, int]:
    """The width and height of the road's pictures.

    - given: the size that the user gave, for labels whose pictures are not there.
    """
    if lines:
        labels = read_labels(lines)[:first]
        if given is None:
            return size_of_pictures(labels, Path(lines))
        check_size(given, labels, Path(lines))
        return given
    skipped: list[str] = []
    for _, image in read_images(files_matching(str(stills))[:first], skipped):
        return size_of(image)
    raise InputError(f"{stills}: no picture among {len(skipped)} files; {skipped[0]}")


def _draw(road: SeenRoad, target: Path) -> None:
    """Draw the view on the picture whose lines run straightest ahead."""
    path, lines = road.straightest()
    if path is None:
        raise InputError("picture: none of the labelled pictures is there to draw on")
    write_picture(target, draw_view(read_image(path), road.view, lines))


def _warn_of(skipped: Sequence[str]) -> None:
    for line in skipped:
        warnings.warn(f"skipped: {line}", UserWarning, stacklevel=3)
