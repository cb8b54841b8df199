"""Labelled pictures as the task of a search: a detector's parameters are searched on them.

    name: pictures_mc
    pictures:
      labels: labels.jsonl
      camera: camera.yaml
      detector: mc
    tuning: {trials: 200, parameters: {detector.least_score: [0.05, 0.3]}}

Labels are TuSimple's. A labelled picture whose folder has others that no label names is the end
of a clip: the detector follows the clip and its valid lines are scored. Else it is a still, and
every line that the detector gives is. What is held out are contiguous blocks of labelled pictures.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import file_entry
from egolane_pgm.experiment import Experiment
from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.plugins import OWN_FILES, source_files
from egolane_pgm.scoring.bootstrap import bootstrap_interval
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.scoring.line_places import LINE_SCORES, line_counts
from egolane_pgm.tools.files import plain
from egolane_pgm.tuning.objective import DETECTOR, split
from egolane_pgm.tuning.plan import Pictures, Plan
from egolane_pgm.tuning.search import Score
from egolane_pgm.tuning.space import Point, SearchSpace, make_space, to_parameters, to_point
from egolane_pgm.tuning.task import Task, checksum, identity_of
from egolane_pgm.types import NOTE, FloatArray, InputError, IntArray
from egolane_pgm.vision.calibration.labels import label_picture, label_places, read_labels
from egolane_pgm.vision.camera.model import Camera, read_camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.camera.pictures import open_source, read_image
from egolane_pgm.vision.detectors import networks, powers, simple
from egolane_pgm.vision.detectors.pictures import pictures_in
from egolane_pgm.vision.detectors.runner import (
    Detector,
    check_pair,
    detect,
    find_detector,
    own_files,
    start,
)

#: Labelled pictures that the bootstrap draws together: neighbours show one stretch of road.
_ALIKE = 5


def detector_of(experiment: Experiment) -> Detector:
    """Return the experiment's detector. Raises InputError for a recording without one."""
    recording, source = experiment.recording, experiment.source
    if recording.detector is None:
        raise InputError(
            f"{source}: tuning.search: detector: the recording has none; it goes with pictures or a"
            " video and recording.detector"
        )
    where = f"{source}: recording.detector"
    given = recording.detector_parameters
    return find_detector(recording.detector, given, experiment.folder, where)


def searched(detector: Detector) -> tuple[list[Parameter], dict[str, Value]]:
    """The parameters that a detector declares, and their values, as a search names them."""
    specs = getattr(detector.module, "PARAMETERS", ())
    values = {DETECTOR + name: value for name, value in detector.parameters.items()}
    return [replace(spec, name=DETECTOR + spec.name) for spec in specs], values


def code_of(detector: Detector) -> str:
    """The checksum of a detector's code, and of a network that it looks through."""
    files = source_files(detector.module)
    if not detector.name.endswith(OWN_FILES):
        files = [*files, *source_files(simple), *source_files(networks)]
    return checksum(files + own_files(detector))


@dataclass(frozen=True)
class Clip:
    """A labelled picture and those before it.

    - label_m: (A,) places of the labelled lines, metres to the right
    - pictures: in order; the last one is labelled
    """

    label_m: FloatArray
    pictures: tuple[Path, ...]


@dataclass(frozen=True)
class Labelled:
    """K clips of a plan, and the detector that looks at them.

    - files: of labels and camera.
    - space: of the detector's parameters.
    """

    given: Pictures
    detector: Detector
    camera: Camera
    clips: tuple[Clip, ...]
    files: tuple[Path, ...]
    space: SearchSpace


def load_labelled(plan: Plan) -> Labelled:
    """Read labels and camera of a plan, and make the search space.

    Raises InputError, naming file and key, for whatever does not fit, and for labels whose
    pictures are missing.
    """
    _ = plan.settings  # Checked before anything is read.
    given, folder = plan.pictures, Path(plan.source).parent
    assert given is not None
    where = f"{plan.source}: pictures"
    detector = find_detector(given.detector, given.detector_parameters, folder, f"{where}.detector")
    files = []
    for key in ("camera", "labels"):
        files.append(folder / Path(getattr(given, key)).expanduser())
        if not files[-1].is_file():
            raise InputError(f"{where}.{key}: no file {files[-1]}")
    camera_file, labels = files
    camera = read_camera(camera_file)
    check_pair(detector, camera, False, f"{where}.detector")
    start(detector, camera)  # Only to refuse early a camera that does not see the road.
    clips = _clips(given, labels, camera, f"{where}.frames")
    specs, current = searched(detector)
    where = f"{plan.source}: tuning.parameters"
    if not plan.tuning.parameters and not any(spec.is_searched for spec in specs):
        example = next((spec.name for spec in specs if spec.kind == "positive"), "NAME")
        raise InputError(
            f"{where}: is missing; name what is searched, with bounds: {{{example}: [low, high]}}"
            f" (`egolane show {detector.name}` lists the parameters)"
        )
    space = make_space(specs, current, plan.tuning.parameters, 1, where)
    return Labelled(given, detector, camera, clips, (labels, camera_file), space)


def _clips(given: Pictures, labels: Path, camera: Camera, where: str) -> tuple[Clip, ...]:
    frames = read_labels(labels)
    first, stop = given.frames or (0, len(frames))
    if stop > len(frames):
        raise InputError(f"{where}: {[first, stop]}: {labels} has {len(frames)} labelled pictures")
    pictures = [label_picture(frame, labels) for frame in frames]
    in_folder = Counter(picture.parent for picture in pictures)
    clips = []
    for frame, picture in zip(frames[first:stop], pictures[first:stop], strict=True):
        before: tuple[Path, ...] = (picture,)
        if in_folder[picture.parent] == 1:
            files = open_source(picture.parent).files
            before = files[: files.index(picture) + 1]
        clips.append(Clip(label_places(camera, frame, given.ahead_m), before))
    return tuple(clips)


def check(plan: Plan) -> str:
    """Check a plan without looking at a picture; return what it has, in a few words."""
    seen = load_labelled(plan)
    return f"{len(seen.clips)} labelled pictures, {len(seen.space)} numbers searched"


def picture_task(plan: Plan, held_out: str) -> Task:
    """Read the labels of a plan; see `tuning.task.task_of`."""
    seen, n_blocks = load_labelled(plan), plan.tuning.blocks
    if held_out == "recordings":
        raise InputError(
            f"{plan.source}: whole_recordings: labelled pictures are one recording; their blocks"
            " are held out"
        )
    parts = blocks(len(seen.clips), n_blocks) if held_out == "blocks" else []
    _, current = searched(seen.detector)
    known = None if plan.tuning.from_scratch else to_point(seen.space, current)
    notes = [f"{NOTE}the current values lie outside of the bounds and are not tried first"]
    pictures = [clip.pictures[-1] for clip in seen.clips]
    data = [
        {**file_entry(path, pictures_in), "path": path.name} for path in (*seen.files, *pictures)
    ]
    spaces = {plan.name: seen.space}
    searched_on = {
        **seen.given.model_dump(mode="json", exclude={"labels", "camera"}),
        "data": [entry["sha256"][:16] for entry in data],
        "code": code_of(seen.detector),
    }
    return Task(
        plan=plan,
        settings=plan.settings,
        spaces=spaces,
        starts=[] if known is None else [known],
        notes=notes if known is None and not plan.tuning.from_scratch else [],
        held_out=held_out,
        part="block",
        left_out=[None] * len(parts),
        identity=identity_of(plan, spaces, pictures=searched_on),
        parts_key={"blocks": n_blocks},
        data=data,
        document={
            "run": None,
            "scores": list(LINE_SCORES),
            "experiments": [{"parameters": current}],
        },
        scorer=partial(_scorer, seen, plan.settings.objectives, parts),
        answers=partial(_stitched, seen),
        assess=_assess,
        parameters=lambda point: {plan.name: _parameters(seen, point)},
        experiments=partial(_for_include, seen),
    )


def counts_of(seen: Labelled, point: Point, which: Sequence[int] | None = None) -> IntArray:
    """Look at the clips with the parameters of a point: (K, 4), per labelled picture what
    `scoring.line_places.line_counts` counts. which: only these clips."""
    detector = replace(seen.detector, parameters=_parameters(seen, point))
    chosen = range(len(seen.clips)) if which is None else which
    return np.array([_looked_at(seen, detector, seen.clips[k]) for k in chosen])


def _parameters(seen: Labelled, point: Point) -> dict[str, Value]:
    return split(to_parameters(seen.space, point))[1]


def _looked_at(seen: Labelled, detector: Detector, clip: Clip) -> IntArray:
    pictures = (Picture(k, read_image(path)) for k, path in enumerate(clip.pictures))
    for _, found in detect(detector, seen.camera, pictures):
        lines = found
    places = lines.shape @ powers(seen.given.ahead_m)
    if len(clip.pictures) > 1:
        places = places[lines.is_valid]
    return line_counts(clip.label_m, places, seen.given.side_m, seen.given.tolerance_m)


def _scorer(
    seen: Labelled, objectives: Sequence[str], parts: Sequence[IntArray], part: int | None
) -> Score:
    """The score of a point on all clips, or without those of a part."""
    which = None
    if part is not None:
        which = np.concatenate([each for k, each in enumerate(parts) if k != part]).tolist()

    def score(point: Point) -> list[float]:
        total = counts_of(seen, point, which).sum(axis=0)
        return [float(np.nan_to_num(LINE_SCORES[name](total))) for name in objectives]

    return score


def _assess(counts: IntArray, minus: IntArray | None = None) -> dict[str, Any]:
    """The scores of counts, or how much more they are than those of others, with intervals where
    there are pictures enough; see `Task`."""
    sides = [counts] if minus is None else [counts, minus]
    n_clips = len(counts)
    found: dict[str, Any] = {"frames_scored": n_clips, "intervals": {}}
    for name, score in LINE_SCORES.items():
        values = [float(score(side.sum(axis=0))) for side in sides]
        found[name] = values[0] - sum(values[1:])
        bounds = None
        if n_clips >= 2 * _ALIKE:
            interval = bootstrap_interval(sides[:1], score, minus=sides[1:] or None, block=_ALIKE)
            bounds = [interval.low, interval.high]
        found["intervals"][name] = bounds
    return {"all_frames": found}


def _stitched(seen: Labelled, points: Sequence[Point]) -> IntArray:
    """What is counted with one point, or in each block with that of its own."""
    if len(points) == 1:
        return counts_of(seen, points[0])
    each = zip(points, blocks(len(seen.clips), len(points)), strict=True)
    return np.concatenate([counts_of(seen, point, part.tolist()) for point, part in each])


def _for_include(seen: Labelled, point: Point) -> dict[str, dict[str, Any]]:
    """What was found as a YAML file for `include:` in an experiment on pictures."""
    names = {d.parameter.removeprefix(DETECTOR) for d in seen.space.dimensions}
    values = {name: v for name, v in _parameters(seen, point).items() if name in names}
    recording = {"detector": seen.given.detector, "detector_parameters": values}
    return {"best.yaml": plain({"recording": recording})}
