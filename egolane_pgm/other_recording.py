"""An experiment on another recording than its YAML names."""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.experiment import Experiment, make_experiment
from egolane_pgm.loading import VIDEOS
from egolane_pgm.recordings import FORMATS, files_of, format_of
from egolane_pgm.types import InputError


def with_recording(
    experiment: Experiment,
    recording: str | None,
    ground_truth: str | None,
    n_lanes: int | None,
    frame_id: str | None = None,
    camera: str | None = None,
    detector: str | None = None,
) -> Experiment:
    """The experiment on another recording. What belongs to the old recording (frame range, seed,
    ground truth and its extra rows) does not carry over, nor do `format`, `topic`, `frame_id` and
    `camera` where the extension of the file is another one; `detector`, its parameters and camera
    do for a video and pictures (a folder, a glob, one file), and for nothing else.
    `ground_truth` may be "none". camera, detector: for a video or pictures.

    Raises InputError for a folder of recordings, and for one that has both pictures and lines where
    nothing says which are meant.
    """
    content = experiment.model_dump()
    if "frame_rate" not in experiment.recording.model_fields_set:
        # A video may tell its own.
        del content["recording"]["frame_rate"]
    if experiment.recording.simulate is not None and recording is None and ground_truth == "none":
        raise InputError(
            f"{experiment.source}: --ground-truth none: a simulated drive brings its own;"
            " write it to files with `egolane simulate` and run on those"
        )
    if recording is not None:
        kept = {"frame_rate", "missing_frames", "lri"}
        old = experiment.recording
        if old.detector is not None and _is_of_pictures(recording, old.path, detector):
            kept |= {"camera", "detector", "detector_parameters"}
        elif old.detector is None and Path(recording).suffix == Path(old.path or "").suffix:
            kept |= {"format", "topic", "frame_id", "options", "camera"}
        content["recording"] = {k: v for k, v in content["recording"].items() if k in kept}
        content["recording"]["path"] = str(Path(recording).absolute())
        content["ground_truth"] = None
        content["tuning"] = None
        content["name"] = as_name(Path(recording).stem)
        content["tuned_on"] = (
            "other_frames" if experiment.tuned_on == "same_frames" else (experiment.tuned_on)
        )
    if frame_id is not None:
        content["recording"]["frame_id"] = frame_id
    if camera is not None:
        content["recording"]["camera"] = str(Path(camera).absolute())
    if detector is not None:
        is_own = detector.endswith(".py")
        if detector != content["recording"].get("detector"):
            content["recording"].pop("detector_parameters", None)
        content["recording"]["detector"] = str(Path(detector).absolute()) if is_own else detector
    if ground_truth is not None:
        content["ground_truth"] = (
            None if ground_truth == "none" else {"path": str(Path(ground_truth).absolute())}
        )
    if n_lanes is not None:
        content["n_lanes"] = n_lanes
    return make_experiment(content, experiment.folder, experiment.source)


def _is_of_pictures(recording: str, old: str | None, detector: str | None) -> bool:
    """Whether a recording is a video or pictures. detector: asked for with the recording, which
    says that pictures are meant."""
    from egolane_pgm.camera.pictures import PICTURES, is_pattern

    path = Path(recording).expanduser()
    if path.is_dir():
        return _is_folder_of_pictures(path, detector)
    ending = path.suffix.lower()
    lines = {ending for extensions, _, _ in FORMATS.values() for ending in extensions}
    if is_pattern(recording) or ending in (*PICTURES, *VIDEOS):
        return True
    return ending not in lines and ending == Path(old or "").suffix.lower()


def _is_folder_of_pictures(folder: Path, detector: str | None) -> bool:
    from egolane_pgm.camera.pictures import PICTURES

    try:
        endings = {path.suffix.lower() for path in folder.iterdir() if path.is_file()}
    except OSError as error:
        raise InputError(f"--recording {folder}: cannot be read: {error.strerror}") from None
    has_pictures = not endings.isdisjoint(PICTURES)
    try:
        format_of(folder)
        has_lines = True
    except InputError:
        has_lines = False
    if has_pictures and has_lines and detector is None:
        raise InputError(
            f"--recording {folder}: has pictures and lines ({files_of(folder)[0].name}, ...); say"
            " which: --detector NAME looks at the pictures, --set recording.detector=null reads"
            " the lines"
        )
    drives = (*VIDEOS, ".bag", ".csv", ".parquet", ".jsonl")
    if not has_pictures and not has_lines and not endings.isdisjoint(drives):
        raise InputError(
            f"--recording {folder}: is a folder of recordings; name one of them, or several, each"
            " with a --recording of its own"
        )
    return has_pictures or not has_lines or detector is not None


def as_name(stem: str) -> str:
    """A name for an experiment, from that of a file."""
    kept = (c if (c.isascii() and c.isalnum()) or c in "._-" else "_" for c in stem)
    name = "".join(kept).lstrip("._-")
    return name or "recording"
