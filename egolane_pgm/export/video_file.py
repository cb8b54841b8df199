"""A result as a video of the pictures that its detector saw."""

from __future__ import annotations

from itertools import tee
from pathlib import Path

from egolane_pgm.export import chosen_frames
from egolane_pgm.inference.events import CONFIDENT
from egolane_pgm.result import Result, lanes_of
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import UNASSIGNED, InputError
from egolane_pgm.vision.camera.pictures import camera_of_pictures, read_pictures
from egolane_pgm.vision.camera.writing import video_writer
from egolane_pgm.vision.detectors.pictures import open_pictures
from egolane_pgm.vision.detectors.runner import detect
from egolane_pgm.vision.video import Scene, draw_frame, layout

#: The column of the probability that the sensor works.
SENSOR_OK = "SensorState_OK"


def write_video(file: Path, result: Result, frames: tuple[int, int] | None = None) -> None:
    """Write a result as an .mp4.

    The detector runs again, from the first picture of the run, because a result has the offsets of
    the lines and not their shape. If it stops early, the frames before are kept.

    - frames: first and last frame id; all by default.

    Raises InputError for a result without pictures, and if the file cannot be written.
    """
    shown = chosen_frames(result, frames)
    experiment = result.experiment
    if experiment.recording.detector is None:
        raise InputError(
            f"{result.directory or result.name}: has no pictures to draw; a video needs the result"
            " of a run with a detector (recording.detector)"
        )
    detector, camera, left, right = open_pictures(experiment)
    camera = camera_of_pictures(camera, left)
    start = 0 if experiment.recording.frames is None else experiment.recording.frames[0]
    pictures = read_pictures(left, camera, right, (start, int(shown.index[-1]) + 1))
    posterior = lanes_of(shown)
    places = layout(camera)
    time_s = shown["time_s"].tolist()
    # A probable lane is not yet an answer that one should see.
    is_sure = posterior.max(axis=1) >= CONFIDENT
    answer = shown["assigned_lane"].where(is_sure, UNASSIGNED).tolist()
    works = shown[SENSOR_OK].tolist() if SENSOR_OK in shown else [None] * len(shown)
    truth = shown["true_lane"].fillna(0).tolist()
    with (
        bar(desc=detector.name, unit="frame", total=len(shown)) as progress,
        video_writer(file, result.frame_rate, places.size) as write,
    ):
        # The detector takes one picture at a time, so no more than one is kept.
        drawn, given = tee(pictures)
        for picture, (_, lines) in zip(drawn, detect(detector, camera, given), strict=True):
            if picture.frame_id not in shown.index:
                continue
            row = int(shown.index.get_loc(picture.frame_id))
            belief = posterior[row], answer[row], truth[row] or None
            scene = Scene(picture.frame_id, time_s[row], lines, *belief, works[row])
            write(draw_frame(places, picture.image, scene))
            progress.update()
