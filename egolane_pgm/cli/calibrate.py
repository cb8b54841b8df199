"""The command `egolane calibrate`: chessboards and roads in, a camera's YAML out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click

from egolane_pgm.calibration.chessboard import calibrate_lens, camera_with, describe_lens
from egolane_pgm.calibration.drawing import draw_view
from egolane_pgm.calibration.labels import (
    check_size,
    read_labels,
    size_of_pictures,
    view_from_labels,
)
from egolane_pgm.calibration.road_lines import find_in_stills, view_from_stills
from egolane_pgm.calibration.straight_road import (
    ASSUMED_FIELD_OF_VIEW,
    SeenRoad,
    assumed_camera,
    check_lane_width,
    describe_assumed_lens,
    describe_view,
)
from egolane_pgm.calibration.video_stills import take_stills
from egolane_pgm.camera.model import Camera, write_camera
from egolane_pgm.camera.pictures import (
    PICTURES,
    files_matching,
    open_source,
    read_image,
    read_images,
    size_of,
)
from egolane_pgm.camera.writing import check_picture_name, write_picture
from egolane_pgm.recordings.openlane import PICTURE_SIZE, read_own_camera
from egolane_pgm.tools.files import check_not_read, check_place, temporary_folder
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError

Rectangle = tuple[int, int, int, int]

_Given = TypeVar("_Given")

#: How many of the frames taken from a video are used.
CHOSEN = 30


@click.command()
@click.option("--chessboards", metavar="GLOB", help="Pictures of a chessboard, for the lens.")
@click.option(
    "--board",
    default="9x6",
    show_default=True,
    metavar="COLUMNSxROWS",
    help="Inner corners of the chessboard.",
)
@click.option(
    "--stills",
    metavar="GLOB|VIDEO",
    help="Pictures of a straight road, or a video: its lines are found.",
)
@click.option("--lines", metavar="FILE", help="Labelled lines instead: TuSimple JSON lines.")
@click.option(
    "--openlane",
    metavar="FILE",
    help="OpenLane's JSON of a picture instead: the camera that it names.",
)
@click.option("--lane-width", type=float, metavar="M", help="Of that road's lanes, metres.")
@click.option(
    "--first", type=click.IntRange(1), metavar="N", help="Only the first N stills or labels."
)
@click.option("--size", metavar="WxH", help="Of the labelled pictures, where they are not there.")
@click.option(
    "--field-of-view",
    type=float,
    metavar="DEGREES",
    help="Horizontal, where there are no chessboards; 62 is assumed.",
)
@click.option("--roll", default=0.0, metavar="DEGREES", help="Clockwise; default 0.")
@click.option(
    "--lateral", default=0.0, metavar="M", help="Right of the vehicle's middle; default 0."
)
@click.option("--baseline", type=float, metavar="M", help="Of a rectified stereo pair.")
@click.option(
    "--ignore",
    "rectangles",
    multiple=True,
    metavar="LEFT,TOP,RIGHT,BOTTOM",
    help="Pixels that never show road (mirror, dashboard); kept in the YAML. Repeatable.",
)
@click.option("--ignore-below", type=click.IntRange(1), metavar="ROW", help="The same: bonnet.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--picture",
    type=click.Path(dir_okay=False),
    metavar="PNG",
    help="Draw lines, horizon and a grid of metres on a still.",
)
@click.option(
    "-o",
    "--out",
    "target",
    required=True,
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="The camera's YAML.",
)
def calibrate(
    chessboards: str | None,
    board: str,
    stills: str | None,
    lines: str | None,
    openlane: str | None,
    lane_width: float | None,
    first: int | None,
    size: str | None,
    field_of_view: float | None,
    roll: float,
    lateral: float,
    baseline: float | None,
    rectangles: tuple[str, ...],
    ignore_below: int | None,
    seed: int,
    picture: str | None,
    target: str,
) -> None:
    """Find out how a camera sees the road: lens from chessboards, turn and height from lines."""
    if openlane is not None:
        if any(given is not None for given in (chessboards, stills, lines, lane_width, picture)):
            raise InputError("--openlane: goes alone, with --size; it names the whole camera")
        _write_openlane(openlane, size, rectangles, Path(target))
        return
    if lane_width is None:
        raise InputError("--lane-width: is missing; the lanes of the road are so many metres wide")
    check_lane_width(lane_width)
    if (stills is None) == (lines is None):
        raise InputError("give either --stills of a road or --lines with labels")
    if chessboards and field_of_view is not None:
        raise InputError("--field-of-view: goes without --chessboards, which measure the lens")
    if size and not lines:
        raise InputError("--size: goes with --lines; stills say their own size")
    if picture:
        check_picture_name(picture)
    for place in (target, *([picture] if picture else [])):
        _check_not_read(Path(place), [chessboards, stills], lines)
        check_place(Path(place))
    masks = tuple(_rectangle(text) for text in rectangles)
    video, most = stills, None
    if stills and is_video(stills):
        if first is not None:
            raise InputError("--first: goes with pictures or labels; of a video frames are chosen")
        folder = click.get_current_context().with_resource(temporary_folder())
        taken = take_stills(open_source(stills), folder, lambda places: _progress(places, "frames"))
        stills, most = str(folder), CHOSEN
    known = _known_size(_size(size, "--size") if size else None, stills, lines, first)
    _check_masks(masks, known)
    camera, words = _lens(chessboards, board, known, field_of_view)
    if ignore_below is not None:
        if ignore_below >= camera.height:
            raise InputError(
                f"--ignore-below: row {ignore_below} is not in a picture {camera.height} high"
            )
        masks = (*masks, (0, ignore_below, camera.width, camera.height))
    camera = replace(camera, roll_deg=roll, lateral_m=lateral, baseline_m=baseline, ignore=masks)
    if stills:
        paths = files_matching(stills)[:first]
        found = find_in_stills(camera, paths, seed, lambda paths: _progress(paths, "stills"), most)
        _say_skipped(found.skipped)
        if most is not None:
            what = f"{len(found.paths)} of {len(taken)} frames taken from {video}"
            words.append(f"Stills: {what}, those with the clearest straight lines.")
        road = view_from_stills(camera, found, lane_width)
    else:
        road = view_from_labels(
            camera, str(lines), first, lane_width, lambda frames: _progress(frames, "labels")
        )
    words += describe_view(road.view, road.what)
    if roll:
        words.append(f"Roll: {roll:g} degrees, given.")
    write_camera(target, road.view.camera, "\n".join(["Made by `egolane calibrate`.", *words]))
    for line in words:
        click.echo(line)
    click.echo(f"written to {target}")
    if picture:
        _draw(road, Path(picture))


def _write_openlane(file: str, size: str | None, rectangles: Sequence[str], target: Path) -> None:
    """Write the camera that a file of OpenLane's names."""
    check_not_read(target, [Path(file)])
    check_place(target)
    known = _size(size, "--size") if size else PICTURE_SIZE
    masks = tuple(_rectangle(text) for text in rectangles)
    _check_masks(masks, known)
    camera = replace(read_own_camera(file, known), ignore=masks)
    words = [f"Camera: as {file} says, pictures of {known[0]}x{known[1]}."]
    write_camera(target, camera, "\n".join(["Made by `egolane calibrate`.", *words]))
    for line in (*words, f"written to {target}"):
        click.echo(line)


def is_video(path: str) -> bool:
    """Whether a path is a file that is read as a video."""
    return Path(path).is_file() and Path(path).suffix.lower() not in PICTURES


def _numbers(text: str, separator: str, n: int, option: str, example: str) -> tuple[int, ...]:
    parts = text.lower().split(separator)
    if len(parts) != n or not all(part.strip().isdecimal() for part in parts):
        raise InputError(f"{option}: '{text}' is not {example}")
    return tuple(int(part) for part in parts)


def _size(text: str, option: str) -> tuple[int, int]:
    first, second = _numbers(text, "x", 2, option, "two whole numbers, e.g. 1280x720")
    return first, second


def _rectangle(text: str) -> Rectangle:
    example = "left,top,right,bottom in pixels, e.g. 0,600,1280,720"
    left, top, right, bottom = _numbers(text, ",", 4, "--ignore", example)
    return left, top, right, bottom


def _check_masks(masks: Sequence[Rectangle], size: tuple[int, int]) -> None:
    """Raise InputError for a rectangle that covers nothing of the pictures."""
    for mask in masks:
        if mask[0] >= size[0] or mask[1] >= size[1]:
            said = ",".join(map(str, mask))
            raise InputError(f"--ignore: {said} is not in a picture of {size[0]}x{size[1]}")


def _check_not_read(place: Path, patterns: Sequence[str | None], lines: str | None) -> None:
    """Raise InputError if the output would replace a file that is read."""
    read = [Path(lines)] if lines else []
    for pattern in filter(None, patterns):
        read += [p for p in _matching_or_none(pattern) if p.name == place.name]
    check_not_read(place, read)


def _matching_or_none(pattern: str) -> list[Path]:
    try:
        return files_matching(pattern)
    except InputError:
        return []


def _known_size(
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


def _lens(
    chessboards: str | None, board: str, size: tuple[int, int], field_of_view: float | None
) -> tuple[Camera, list[str]]:
    if not chessboards:
        degrees = ASSUMED_FIELD_OF_VIEW if field_of_view is None else field_of_view
        return assumed_camera(*size, degrees), describe_assumed_lens(degrees)

    columns, rows = _size(board, "--board")
    lens = calibrate_lens(_progress(files_matching(chessboards), "chessboards"), columns, rows)
    _say_skipped(lens.skipped)
    for name, rms in zip(lens.boards, lens.rms_px, strict=True):
        click.echo(f"{name}: {rms:.2f} px RMS")
    return camera_with(lens, size), describe_lens(lens, board)


def _draw(road: SeenRoad, target: Path) -> None:
    """Draw the view on the picture whose lines run straightest ahead."""
    path, lines = road.straightest()
    if path is None:
        click.echo("--picture: none of the labelled pictures is there to draw on", err=True)
        return
    write_picture(target, draw_view(read_image(path), road.view, lines), make_folder=True)
    click.echo(f"{target}: drawn on {path.name}")


def _progress(given: Iterable[_Given], what: str) -> Iterable[_Given]:
    shown: Iterable[_Given] = bar(given, desc=what, unit="picture")
    return shown


def _say_skipped(skipped: tuple[str, ...]) -> None:
    for line in skipped:
        click.echo(f"skipped: {line}", err=True)
