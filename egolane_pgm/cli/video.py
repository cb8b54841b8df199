"""The command `egolane video`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import click

from egolane_pgm.camera.model import read_camera
from egolane_pgm.camera.pictures import Source, camera_of_pictures, open_source, read_pictures
from egolane_pgm.cli import options
from egolane_pgm.detectors.runner import Detector, check_pair, find_detector
from egolane_pgm.experiment import Experiment, experiments_folder, load_experiment, make_experiment
from egolane_pgm.recordings import read_lines_with
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.report.video import (
    draw_frame,
    frame_writer,
    layout,
    scenes,
    with_detected_lines,
    with_recorded_lines,
)
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError


@click.command()
@click.argument("pictures")
@options.camera
@click.option(
    "--detector",
    metavar="NAME|FILE.py",
    shell_complete=options.detectors,
    help="What looks at the pictures; `egolane ls` lists them.  [default: the experiment's, or ml]",
)
@click.option(
    "--lines",
    "lines_file",
    metavar="FILE",
    help="Draw this recording of lines instead of what a detector sees.",
)
@options.right
@click.option(
    "--experiment",
    "experiment_file",
    type=click.Path(dir_okay=False),
    metavar="X.yaml",
    help="Evidence, graph, filter and parameters.  [default: position in lane, no labels needed]",
)
@click.option("--n-lanes", type=click.IntRange(1), help="Number of lanes of the road.")
@click.option(
    "--ground-truth", "truth_file", metavar="FILE", help="The annotated lanes, where known."
)
@options.frames
@click.option(
    "--frame-rate",
    type=click.FloatRange(0.1, 1000),
    help="Frames per second.  [default: the video's]",
)
@click.option(
    "-o",
    "--out",
    "target",
    required=True,
    type=click.Path(),
    metavar="OUT.mp4|DIR",
    help="The video, or a folder for PNG pictures.",
)
def video(
    pictures: str,
    camera_file: str,
    detector: str | None,
    lines_file: str | None,
    right_pictures: str | None,
    experiment_file: str | None,
    n_lanes: int | None,
    truth_file: str | None,
    frames: tuple[int, int] | None,
    frame_rate: float | None,
    target: str,
) -> None:
    """Draw a drive: PICTURES (a video, a folder or a 'glob*.jpg') with the lines on them, the
    bird's-eye view, the belief over the lanes, and the truth where it is known.

    What was drawn before Ctrl-C, or before a picture that cannot be used, is kept.
    """
    if not target:
        raise InputError("--out: is empty; name a video (.mp4) or a folder")
    if frames is not None and frames[0] >= frames[1]:
        raise InputError(f"--frames {frames[0]} {frames[1]}: is an empty range")
    if lines_file and (detector or right_pictures):
        wrong = "--detector" if detector else "--right"
        raise InputError(f"{wrong}: does not go with --lines, whose lines are drawn as they are")
    camera = read_camera(camera_file)
    source = open_source(pictures)
    camera = camera_of_pictures(camera, source)
    right = open_source(right_pictures) if right_pictures else None
    _check_target(Path(target), [source, *([right] if right else [])])
    experiment = _experiment(experiment_file, n_lanes, frame_rate or source.frame_rate)
    truth = read_ground_truth(truth_file) if truth_file else None
    if truth is not None:
        truth.check_lanes(experiment.n_lanes)
    seen = bar(
        read_pictures(source, camera, right, frames),
        unit="frame",
        total=None if frames else source.n_frames,
    )
    if lines_file:
        log = read_lines_with(lines_file, camera, experiment.recording.frame_rate)
        pairs = with_recorded_lines(seen, log, source)
    else:
        chosen = _chosen_detector(detector, experiment)
        check_pair(chosen, camera, right is not None, "--right")
        seen.set_description(chosen.name)
        pairs = with_detected_lines(seen, chosen, camera)
    places = layout(camera)
    n_drawn = 0
    try:
        with frame_writer(target, experiment.recording.frame_rate, places.size) as write:
            for picture, scene in scenes(pairs, experiment, truth, pictures):
                write(picture.frame_id, draw_frame(places, picture.image, scene))
                n_drawn += 1
    except InputError as error:
        if not n_drawn or not Path(target).exists():
            raise
        raise InputError(f"{error}; the {n_drawn} frames before are in {target}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{n_drawn} frames are in {target}; the same command begins anew"
        ) from None
    finally:
        seen.close()
    click.echo(f"{target}: {n_drawn} frames")


def _check_target(target: Path, sources: Sequence[Source]) -> None:
    """Raise InputError if the output would replace the pictures, or lie among them."""
    for source in sources:
        taken = {os.path.realpath(file) for file in source.files}
        if not source.is_video:
            taken |= {os.path.dirname(file) for file in taken}
        # Not `resolve`, which ends in an error of its own where a link leads to itself.
        if os.path.realpath(target) in taken:
            raise InputError(f"{target}: has the pictures that are drawn; name another place (-o)")


def _experiment(file: str | None, n_lanes: int | None, frame_rate: float | None) -> Experiment:
    """The experiment that turns lines into beliefs; its own recording is not used."""
    found = load_experiment(file or experiments_folder() / "zero_label.yaml")
    if file is None and n_lanes is None:
        raise InputError("--n-lanes: say how many lanes the road has")
    content = found.model_dump()
    if frame_rate is not None:
        content["recording"]["frame_rate"] = frame_rate
    if n_lanes is not None:
        content["n_lanes"] = n_lanes
    return make_experiment(content, found.folder, found.source)


def _chosen_detector(name: str | None, experiment: Experiment) -> Detector:
    """The detector that was named, or the experiment's own, or ml."""
    recording = experiment.recording
    is_own = name is None and recording.detector is not None
    chosen = name or recording.detector or "ml"
    given = recording.detector_parameters if is_own or chosen == recording.detector else {}
    # Files that parameters name lie beside the experiment too.
    base = experiment.folder if is_own or not chosen.endswith(".py") else Path.cwd()
    return find_detector(chosen, given, base, "--detector", "recording.detector_parameters")
