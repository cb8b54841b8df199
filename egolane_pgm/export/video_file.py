"""A result as a video of the pictures that its detector looked at."""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.experiment import load_experiment
from egolane_pgm.export.drive import Drive
from egolane_pgm.results import Result
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import UNASSIGNED, InputError
from egolane_pgm.vision.camera.pictures import camera_of_pictures, read_pictures
from egolane_pgm.vision.camera.writing import video_writer
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.detectors.pictures import Pictures
from egolane_pgm.vision.video import Scene, draw_frame, layout, with_detected_lines


def write_video(path: Path, drive: Drive) -> int:
    """Write a drive as an .mp4; returns the number of frames.

    The detector looks at the pictures again, from the first that the run saw, because a result has
    the offsets of the lines only and not their shape. What was drawn before Ctrl-C, or before a
    picture that cannot be used, is kept.

    Raises InputError for a result without pictures, and where the file cannot be written.
    """
    result = drive.result
    if drive.pictures is None:
        raise InputError(
            f"{result.directory}: has no pictures to draw; a video needs the result of a run with a"
            " detector (recording.detector), whose pictures are still there"
        )
    experiment = load_experiment(result.directory / "experiment.yaml")
    recording = experiment.recording
    detector, camera, left, right = Pictures(experiment).parts()
    camera = camera_of_pictures(camera, left)
    rows = {int(frame_id): k for k, frame_id in enumerate(result.frame_id)}
    start = 0 if recording.frames is None else recording.frames[0]
    seen = read_pictures(left, camera, right, (start, max(rows) + 1))
    places, rate, n_drawn = layout(camera), float(result.run["frame_rate"]), 0
    try:
        with (
            bar(None, None, desc=detector.name, unit="frame", total=len(drive)) as shows,
            video_writer(path, rate, places.size) as write,
        ):
            for picture, lines in with_detected_lines(seen, detector, camera):
                if picture.frame_id in rows:
                    scene = _scene(result, rows[picture.frame_id], lines)
                    write(draw_frame(places, picture.image, scene))
                    n_drawn += 1
                    shows.update()
    except InputError as error:
        if not n_drawn:
            raise
        raise InputError(f"{error}; the {n_drawn} frames before are in {path}") from None
    except KeyboardInterrupt:
        kept = f"{n_drawn} frames are in {path}; the same command begins anew"
        raise KeyboardInterrupt(kept) from None
    return n_drawn


def _scene(result: Result, k: int, lines: FrameLines) -> Scene:
    """Row k of a result, with the lines that the detector sees."""
    truth = int(result.true_lane[k])
    return Scene(
        int(result.frame_id[k]),
        float(result.time_s[k]),
        lines,
        result.marginals["Lane"][k],
        int(result.assigned_lane[k]),
        truth if truth != UNASSIGNED else None,
    )
