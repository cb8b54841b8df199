"""The source of lines from pictures and a detector."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egolane_pgm.experiment import DETECTOR, FROM_MAP, Experiment
from egolane_pgm.loading import camera_beside, existing
from egolane_pgm.recordings.select import rate_of
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import NOTE, InputError, LineLog, problems_in
from egolane_pgm.vision.camera.model import USUAL_LANE_M, Camera, read_camera, write_camera
from egolane_pgm.vision.detectors import FrameLines, as_log
from egolane_pgm.vision.detectors.runner import (
    ReadyDetector,
    detect,
    find_detector,
    start,
)

#: Time stamps of a video that differ less from a constant frame rate, frames, are rounded.
_STEADY = 0.5

#: Time with another number of lanes for a doubt, seconds.
_MINUTE_S = 60.0

if TYPE_CHECKING:
    # OpenCV is imported only where there are pictures.
    from egolane_pgm.vision.camera.pictures import Source as PictureFiles


def open_pictures(
    experiment: Experiment, *, calibrate: bool = True
) -> tuple[ReadyDetector, Camera, PictureFiles, PictureFiles | None]:
    """Return the detector of an experiment, its camera and its pictures (left, and right or None).

    - calibrate: whether to make the camera's file beside the pictures if it is missing.

    Raises InputError, with the key, for anything that cannot be used.
    """
    recording = experiment.recording
    source = experiment.source
    if recording.path is None or recording.format is not None:
        wrong = "simulate" if recording.path is None else "format"
        raise InputError(
            f"{source}: recording.{wrong}: does not go with a detector, which needs a video or"
            " pictures (recording.path)"
        )
    detector = detector_of(experiment, "recording.detector")
    if recording.camera is None:
        raise InputError(
            f"{source}: recording.camera: is missing; the detector needs the camera's YAML"
            " file (`egolane calibrate` makes one)"
        )
    left = pictures_of(experiment, "path")
    place = Path(recording.camera)
    if recording.camera == camera_beside(recording.path) and not place.exists():
        if not calibrate:
            from egolane_pgm.vision.calibration.road_lines import assumed_camera
            from egolane_pgm.vision.camera.pictures import first_size

            return detector, assumed_camera(*first_size(left)), left, None
        calibrate_drive(left, place)
    camera = read_camera(existing(experiment, "recording.camera"))
    if detector.is_stereo == (recording.right is None):
        one = "has one camera; leave the second out"
        wrong = "needs the pictures of a second camera" if detector.is_stereo else one
        raise InputError(f"{source}: recording.right: detector {detector.name} {wrong}")
    if detector.is_stereo and camera.baseline_m is None:
        raise InputError(
            f"{detector.where}: {detector.name} needs the distance of the two cameras, baseline_m"
            " of the camera"
        )
    right = pictures_of(experiment, "right") if detector.is_stereo else None
    # To refuse early a camera that does not show the road.
    start(detector, camera)
    return detector, camera, left, right


def calibrate_drive(source: PictureFiles, file: Path) -> None:
    """Write the camera of a drive, calibrated from its own pictures. Raises InputError, with the
    cure, if it cannot be calibrated or written."""
    from egolane_pgm.vision.calibration.road_lines import ASSUMED_LENS, calibrate_road

    with problems_in("recording.camera: is missing, and cannot be made"):
        check_place(file)
        camera, comment = calibrate_road(source)
    write_camera(file, camera, f"Made from {source.path}.\n{ASSUMED_LENS}\n{comment}")
    warnings.warn(
        f"{NOTE}{file}: made from the pictures, for lanes of {camera.lane_width_m:g} m:"
        f" {camera.height_m:.2f} m above the road, pitch {camera.pitch_deg:.2f} degrees; for other"
        " lanes calibrate again (`egolane calibrate`)",
        stacklevel=2,
    )


def read_pictures(experiment: Experiment) -> tuple[LineLog, float | None]:
    """Return the lines that the detector finds, and the frame rate of a video."""
    log, stopped, left = detect_pictures(experiment)
    if stopped is not None:
        raise stopped
    rate = experiment.recording.frame_rate
    is_given = "frame_rate" in experiment.recording.model_fields_set
    if is_given and left.frame_rate is not None and left.frame_rate != rate:
        warnings.warn(
            f"{left.path}: has {left.frame_rate:g} frames per second, recording.frame_rate is"
            f" {rate:g}; times and delays are counted with the latter",
            stacklevel=2,
        )
    for note in lanes_seen(log, experiment):
        warnings.warn(note, stacklevel=2)
    return log, left.frame_rate


def lanes_seen(log: LineLog, experiment: Experiment) -> Iterator[str]:
    """Doubt the number of lanes if, for a minute in all and for most of the time, another number
    fits between the outermost continuous lines."""
    camera = read_camera(str(experiment.recording.camera))
    edge = np.where(log.is_valid & log.is_continuous, log.offset_m, np.nan)
    # A recording without lines has no columns.
    right_m, left_m = (each.reduce(edge, axis=1, initial=np.nan) for each in (np.fmax, np.fmin))
    width_m = right_m - left_m
    lanes = np.round(width_m[width_m > 0] / (camera.lane_width_m or USUAL_LANE_M))
    other = lanes[lanes != experiment.n_lanes]
    other_s = len(other) * float(np.ptp(log.time_s)) / len(log)
    if other_s >= _MINUTE_S and len(other) > len(lanes) / 2 and experiment.n_lanes != FROM_MAP:
        yield (
            f"{log.source}: doubtful: n_lanes is {experiment.n_lanes}, but between two continuous"
            f" lines {np.median(other):.0f} lanes were seen for {other_s:.0f} s"
        )


def detect_pictures(
    experiment: Experiment, *, stamps: bool = True
) -> tuple[LineLog, KeyboardInterrupt | InputError | None, PictureFiles]:
    """Return the lines that the detector finds, the reason for an early end, and the pictures.

    - stamps: whether the times of a bag are kept if a frame rate is given.

    Ctrl-C and a bad picture keep the frames before; before the first frame they are raised.
    """
    from egolane_pgm.vision.camera.pictures import camera_of_pictures
    from egolane_pgm.vision.camera.pictures import read_pictures as read

    recording = experiment.recording
    detector, camera, left, right = open_pictures(experiment)
    camera = camera_of_pictures(camera, left)
    is_given = "frame_rate" in recording.model_fields_set
    frame_rate = left.frame_rate
    if is_given or frame_rate is None:
        frame_rate = recording.frame_rate
    pictures = bar(
        read(left, camera, right, recording.frames),
        desc=detector.name,
        unit="frame",
        total=left.n_frames if recording.frames is None else None,
    )
    found: list[tuple[int, FrameLines]] = []
    stopped: KeyboardInterrupt | InputError | None = None
    try:
        found.extend(detect(detector, camera, pictures))
    except (KeyboardInterrupt, InputError) as reason:
        if not found:
            raise
        stopped = reason
    log = as_log(found, frame_rate, left.path)
    # Only a video is sought, and its stamps begin at 0.
    if left.stamps and (not is_given or (stamps and left.seek is None)):
        time_s = np.array([left.stamps[k] for k in log.frame_id.tolist()])
        away = np.abs(time_s - log.time_s).max() * frame_rate
        if away > _STEADY and (np.diff(time_s) > 0).all():
            log = replace(log, time_s=time_s)
            left = replace(left, frame_rate=rate_of(log.frame_id, time_s))
    if stopped is None and left.frame_rate is None and not is_given:
        warnings.warn(
            f"{NOTE}{left.path}: has no frame rate: {frame_rate:g} pictures per second are assumed"
            " (set recording.frame_rate)",
            stacklevel=2,
        )
    return log, stopped, left


def detector_of(experiment: Experiment, key: str) -> ReadyDetector:
    """Return the detector of an experiment. Raises InputError, with the key that needs it, if
    the recording has none."""
    recording = experiment.recording
    source = experiment.source
    if recording.detector is None:
        raise InputError(
            f"{source}: {key}: the recording has none; it goes with pictures or a video and"
            " recording.detector"
        )
    where = f"{source}: recording.detector"
    given = experiment.parameters.get(DETECTOR, {})
    given_by = f"{source}: parameters.{DETECTOR}"
    return find_detector(recording.detector, given, where, given_by)


def pictures_of(experiment: Experiment, key: str) -> PictureFiles:
    """Return the pictures at recording.path, or at recording.right (key: "right"). Raises
    InputError, with the key, if there are none."""
    from egolane_pgm.vision.camera.pictures import is_bag, is_pattern, open_source

    path = getattr(experiment.recording, key)
    if is_pattern(path):
        with problems_in(f"{experiment.source}: recording.{key}"):
            return open_source(path)
    place = existing(experiment, f"recording.{key}")
    return open_source(place, experiment.recording.topic if is_bag(place) else None)
