"""The verb `video`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Le

from egolane_pgm.experiment import Experiment, Given, load_experiment
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import CameraFile, Frames, Option, Progress, StrPath, check_frames
from egolane_pgm.vision.camera.model import read_camera
from egolane_pgm.vision.camera.pictures import (
    Source,
    camera_of_pictures,
    open_source,
    read_pictures,
)
from egolane_pgm.vision.camera.writing import frame_writer
from egolane_pgm.vision.detectors.runner import Detector as Found
from egolane_pgm.vision.detectors.runner import check_pair, find_detector
from egolane_pgm.vision.video import (
    draw_frame,
    layout,
    scenes,
    with_detected_lines,
    with_recorded_lines,
)

EXAMPLES = ("egolane video drive.mp4 --camera cam.yaml --detector ml --n-lanes 4 -o out.mp4",)


def video(
    pictures: str,
    *,
    camera: CameraFile,
    detector: Annotated[
        str | None,
        Option("NAME|FILE.py", said="the experiment's, or ml"),
    ] = None,
    lines: Annotated[str | None, Option("FILE")] = None,
    right: Annotated[str | None, Option("PICTURES")] = None,
    experiment: Annotated[
        Given | None, Option("X.yaml", said="position in lane, no labels needed")
    ] = None,
    n_lanes: Annotated[int | None, Ge(1)] = None,
    ground_truth: Annotated[StrPath | None, Option("FILE")] = None,
    frames: Frames = None,
    frame_rate: Annotated[float | None, Ge(0.1), Le(1000), Option(said="the video's")] = None,
    out: Annotated[StrPath, Option("OUT.mp4|DIR", names=("-o",))],
    progress: Progress = None,
) -> int:
    """Draw a drive: PICTURES (a video, a folder or a 'glob*.jpg') with the lines on them, the
    bird's-eye view, the belief over the lanes, and the truth where it is known.

    What was drawn before Ctrl-C, or before a picture that cannot be used, is kept.

    - camera: the camera's YAML.
    - detector: what looks at the pictures; `egolane show` lists them.
    - lines: draw this recording of lines instead of what a detector sees.
    - right: pictures of the second camera.
    - experiment: evidence, graph, filter and parameters.
    - n_lanes: number of lanes of the road.
    - ground_truth: the annotated lanes, where known.
    - frames: frame ids, STOP left out.
    - frame_rate: frames per second.
    - out: the video, or a folder for PNG pictures.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns how many frames were drawn. Raises InputError, one line, for whatever does not fit.
    """
    check_frames(frames)
    if lines and (detector or right):
        wrong = "detector" if detector else "right"
        raise InputError(f"{wrong}: does not go with lines, which are drawn as they are")
    source = open_source(pictures)
    seen_by = camera_of_pictures(read_camera(Path(camera)), source)
    second = open_source(right) if right else None
    target = Path(out)
    _check_target(target, [source, *([second] if second else [])])
    if experiment is None and n_lanes is None:
        raise InputError("n_lanes: say how many lanes the road has")
    changes = {"n_lanes": n_lanes, "recording.frame_rate": frame_rate or source.frame_rate}
    chosen = load_experiment(
        "zero_label" if experiment is None else experiment,
        {key: value for key, value in changes.items() if value is not None},
    )
    truth = read_ground_truth(Path(ground_truth)) if ground_truth else None
    if truth is not None:
        truth.check_lanes(chosen.n_lanes)
    seen = bar(
        read_pictures(source, seen_by, second, frames),
        progress,
        unit="frame",
        total=None if frames else source.n_frames,
    )
    if lines:
        log = read_lines(lines, camera=seen_by, frame_rate=chosen.recording.frame_rate)
        pairs = with_recorded_lines(seen, log, source)
    else:
        found = _detector(detector, chosen)
        check_pair(found, seen_by, second is not None, "right")
        seen.set_description(found.name)
        pairs = with_detected_lines(seen, found, seen_by)
    places = layout(seen_by)
    n_drawn = 0
    try:
        with frame_writer(target, chosen.recording.frame_rate, places.size) as write:
            for picture, scene in scenes(pairs, chosen, truth, pictures):
                write(picture.frame_id, draw_frame(places, picture.image, scene))
                n_drawn += 1
    except InputError as error:
        if not n_drawn or not target.exists():
            raise
        raise InputError(f"{error}; the {n_drawn} frames before are in {target}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{n_drawn} frames are in {target}; the same command begins anew"
        ) from None
    finally:
        seen.close()
    return n_drawn


def says(done: int, given: Mapping[str, Any]) -> str:
    """How many frames were drawn."""
    return f"{given['out']}: {done} frames"


def _check_target(target: Path, sources: Sequence[Source]) -> None:
    """Raise InputError if the output would replace the pictures, or lie among them."""
    for source in sources:
        taken = {os.path.realpath(file) for file in source.files}
        if not source.is_video:
            taken |= {os.path.dirname(file) for file in taken}
        # Not `resolve`, which ends in an error of its own where a link leads to itself.
        if os.path.realpath(target) in taken:
            raise InputError(f"out: {target} has the pictures that are drawn; name another place")


def _detector(name: str | None, experiment: Experiment) -> Found:
    """The detector that was named, or the experiment's own, or ml."""
    recording = experiment.recording
    is_own = name is None and recording.detector is not None
    chosen = name or recording.detector or "ml"
    given = recording.detector_parameters if is_own or chosen == recording.detector else {}
    # Files that parameters name lie beside the experiment too.
    base = experiment.folder if is_own or not chosen.endswith(".py") else Path.cwd()
    return find_detector(chosen, given, base, "detector", "recording.detector_parameters")
