"""Pictures and a detector as a source of lines."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from egolane_pgm.experiment import Experiment
from egolane_pgm.recordings import FORMATS, files_of, format_of
from egolane_pgm.recordings.source import VIDEOS, Read, find_named, whole_path
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, problems_in
from egolane_pgm.vision.camera.model import Camera, read_camera
from egolane_pgm.vision.detectors.runner import (
    Detector,
    check_pair,
    collect,
    detect,
    find_detector,
    own_files,
    start,
)

if TYPE_CHECKING:
    # OpenCV is imported only where there are pictures.
    from egolane_pgm.vision.camera.pictures import Source as PictureFiles


@dataclass(frozen=True)
class Pictures:
    """A video, a folder of pictures or a glob, and the detector that looks at them; see
    `recordings.source.Source`."""

    experiment: Experiment

    def check(self) -> None:
        """See `Source`."""
        self.parts()

    def parts(self) -> tuple[Detector, Camera, PictureFiles, PictureFiles | None]:
        """The detector, its camera and its pictures (left, and right or None)."""
        experiment = self.experiment
        recording, source = experiment.recording, experiment.source
        if recording.path is None or recording.format is not None:
            wrong = "simulate" if recording.path is None else "format"
            raise InputError(
                f"{source}: recording.{wrong}: does not go with a detector, which looks at a video"
                " or pictures (recording.path)"
            )
        detector = detector_of(experiment, "recording.detector")
        if recording.camera is None:
            raise InputError(
                f"{source}: recording.camera: is missing; the detector needs the camera's YAML"
                " file (`egolane calibrate` makes one)"
            )
        camera = read_camera(find_named(experiment, "recording.camera"))
        check_pair(detector, camera, recording.right is not None, f"{source}: recording.right")
        left = pictures_of(experiment, "path")
        right = pictures_of(experiment, "right") if recording.right is not None else None
        # Only to refuse early a camera that does not see the road.
        start(detector, camera)
        return detector, camera, left, right

    def read(self) -> Read:
        """See `Source`: the lines that the detector sees."""
        from egolane_pgm.vision.camera.pictures import (
            camera_of_pictures,
            note_assumed_rate,
            read_pictures,
        )

        recording = self.experiment.recording
        detector, camera, left, right = self.parts()
        camera = camera_of_pictures(camera, left)
        pictures = bar(
            read_pictures(left, camera, right, recording.frames),
            desc=detector.name,
            unit="frame",
            total=left.n_frames if recording.frames is None else None,
        )
        lines = detect(detector, camera, pictures)
        done = collect(lines, recording.frame_rate, left.path, left.time_s)
        if isinstance(done.stopped, InputError) and done.log is not None:
            raise InputError(
                f"{done.stopped}; `egolane detect` writes the lines of the frames before"
            )
        if done.stopped is not None:
            raise done.stopped
        if left.frame_rate is not None and left.frame_rate != recording.frame_rate:
            warnings.warn(
                f"{left.path}: has {left.frame_rate:g} frames per second,"
                f" recording.frame_rate is {recording.frame_rate:g}; times and delays are counted"
                " with the latter",
                UserWarning,
                stacklevel=2,
            )
        if "frame_rate" not in recording.model_fields_set:
            note_assumed_rate(left, recording.frame_rate, "recording.frame_rate")
        assert done.log is not None
        files = [Path(left.path), *([Path(right.path)] if right else [])]
        files.append(find_named(self.experiment, "recording.camera"))
        if detector.name.endswith(".py"):
            files.append((self.experiment.folder / detector.name).resolve())
        return Read(done.log, None, (*files, *own_files(detector)))

    def key(self) -> str:
        """See `Source`."""
        return whole_path(self.experiment)

    def files_in(self, place: Path) -> Sequence[Path]:
        """See `Source`."""
        return pictures_in(place)

    def frame_rate(self) -> float | None:
        """See `Source`: the video's."""
        return pictures_of(self.experiment, "path").frame_rate

    def kept_for(self, recording: str, detector: str | None) -> frozenset[str]:
        """See `Source`: detector and camera go with pictures, and with nothing else."""
        keys = {"camera", "detector", "detector_parameters", "topic"}
        own = self.experiment.recording.path
        return frozenset(keys) if _are_pictures(recording, own, detector) else frozenset()


def detector_of(experiment: Experiment, key: str) -> Detector:
    """Return the detector of an experiment. Raises InputError, naming the key that asks for it, for
    a recording without one."""
    recording, source = experiment.recording, experiment.source
    if recording.detector is None:
        raise InputError(
            f"{source}: {key}: the recording has none; it goes with pictures or a video and"
            " recording.detector"
        )
    where = f"{source}: recording.detector"
    given = recording.detector_parameters
    return find_detector(recording.detector, given, experiment.folder, where)


def pictures_in(place: Path) -> Sequence[Path]:
    """The pictures that a file, a folder or a glob stands for."""
    from egolane_pgm.vision.camera.pictures import open_source

    return open_source(place).files


def pictures_of(experiment: Experiment, key: str) -> PictureFiles:
    """The pictures at recording.path, or those of the second camera (key: "right"). Raises
    InputError, naming the key, where there are none."""
    from egolane_pgm.vision.camera.pictures import is_bag, is_pattern, open_source

    path = getattr(experiment.recording, key)
    if not is_pattern(path):
        place = find_named(experiment, f"recording.{key}", folders=True)
        return open_source(place, experiment.recording.topic if is_bag(place) else None)
    with problems_in(f"{experiment.source}: recording.{key}"):
        return open_source(str(experiment.folder / Path(path).expanduser()))


def _are_pictures(recording: str, old: str | None, detector: str | None) -> bool:
    """Whether a recording is a video or pictures. detector: the one that was asked for together
    with the recording, which means that pictures are meant."""
    from egolane_pgm.vision.camera.pictures import PICTURES, is_bag, is_pattern

    path = Path(recording).expanduser()
    if is_bag(path):
        return detector is not None
    if path.is_dir():
        return _is_folder_of_pictures(path, detector)
    ending = path.suffix.lower()
    lines = {ending for extensions, _, _ in FORMATS.values() for ending in extensions}
    if is_pattern(recording) or ending in (*PICTURES, *VIDEOS):
        return True
    return ending not in lines and ending == Path(old or "").suffix.lower()


def _is_folder_of_pictures(folder: Path, detector: str | None) -> bool:
    from egolane_pgm.vision.camera.pictures import PICTURES

    try:
        endings = {path.suffix.lower() for path in folder.iterdir() if path.is_file()}
    except OSError as error:
        raise InputError(f"recording: {folder}: cannot be read: {error.strerror}") from None
    has_pictures = not endings.isdisjoint(PICTURES)
    try:
        format_of(folder)
        has_lines = True
    except InputError:
        has_lines = False
    if has_pictures and has_lines and detector is None:
        raise InputError(
            f"recording: {folder}: has pictures and lines ({files_of(folder)[0].name}, ...); say"
            " which: a detector looks at the pictures, recording.detector: null reads the lines"
        )
    drives = (*VIDEOS, ".bag", ".csv", ".parquet", ".jsonl")
    if not has_pictures and not has_lines and not endings.isdisjoint(drives):
        raise InputError(
            f"recording: {folder}: is a folder of recordings; name one of them, or several"
        )
    return has_pictures or not has_lines or detector is not None
