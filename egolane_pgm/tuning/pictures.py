"""Searches the parameters of a detector on pictures whose lines are labelled.

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

import functools
import pickle
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import file_entry
from egolane_pgm.parameters import Value
from egolane_pgm.scoring.bootstrap import Interval, bootstrap_interval
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.scoring.line_places import LINE_SCORES, line_counts
from egolane_pgm.tools.files import make_directory, plain, write_json, write_yaml
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.tuning.identity import code_of_detector, search_identity
from egolane_pgm.tuning.nested import Nested, settings_of_part
from egolane_pgm.tuning.objective import DETECTOR
from egolane_pgm.tuning.plan import PicturePlan
from egolane_pgm.tuning.search import (
    Progress,
    Settings,
    best_trial,
    counted,
    search,
    search_in_memory,
)
from egolane_pgm.tuning.space import (
    Point,
    SearchSpace,
    make_space,
    to_parameters,
    to_point,
)
from egolane_pgm.tuning.storage import (
    check_place,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.tuning.study_directory import (
    best_entry,
    head_of,
    held_out_entry,
    read_nested,
    trials_columns,
    write_nested,
    write_trials,
)
from egolane_pgm.types import FloatArray, InputError, IntArray
from egolane_pgm.views.study_trials import STUDY_FILE
from egolane_pgm.vision.calibration.labels import label_picture, label_places, read_labels
from egolane_pgm.vision.camera.model import Camera, read_camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.camera.pictures import open_source, read_image
from egolane_pgm.vision.detectors.pictures import pictures_in
from egolane_pgm.vision.detectors.runner import Detector, check_pair, detect, find_detector, start

#: Labelled pictures that the bootstrap draws together: neighbours show one stretch of road.
_ALIKE = 5


@dataclass(frozen=True)
class Clip:
    """A labelled picture and those before it.

    - label_m: (A,) places of the labelled lines, metres to the right
    - pictures: in order; the last one is labelled
    """

    label_m: FloatArray
    pictures: tuple[Path, ...]


@dataclass(frozen=True)
class PictureProblem:
    """A plan whose labels were read: K clips, and the space of the detector's parameters."""

    plan: PicturePlan
    settings: Settings
    detector: Detector
    camera: Camera
    clips: tuple[Clip, ...]
    space: SearchSpace


@dataclass
class PictureSearch:
    """A search on labelled pictures, and how far it has come; as `study.Search`.

    - test: labelled pictures that take no part and are scored with what is found.
    """

    problem: PictureProblem
    directory: Path
    held_out: str = "blocks"
    storage: str | None = None
    test: PictureProblem | None = None
    notes: list[str] = field(default_factory=list)
    trials: dict[str, list[Any]] = field(default_factory=dict)
    experiments: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def n_parts(self) -> int:
        """Number of studies that are run anew without a block."""
        return 0 if self.held_out == "none" else self.problem.plan.tuning.blocks

    @property
    def spaces(self) -> list[tuple[str, SearchSpace]]:
        """The name of the search, with its search space."""
        return [(self.problem.plan.name, self.problem.space)]

    @property
    def key(self) -> dict[str, Any]:
        """What the nested studies depend on."""
        return {
            **_identity(self.problem),
            "trials": self.problem.settings.trials,
            "blocks": self.problem.plan.tuning.blocks,
        }


def make_problem(plan: PicturePlan) -> PictureProblem:
    """Read labels and camera, and make the search space.

    Raises InputError, naming file and key, for whatever does not fit, and for labels whose
    pictures are missing.
    """
    settings, where = plan.settings, f"{plan.source}: pictures"
    given = plan.pictures
    detector = find_detector(
        given.detector, given.detector_parameters, plan.folder, f"{where}.detector"
    )
    camera = read_camera(_place(plan, "camera"))
    check_pair(detector, camera, False, f"{where}.detector")
    start(detector, camera)  # Only to refuse early a camera that does not see the road.
    clips = _clips(plan, camera)
    specs = [
        replace(spec, name=DETECTOR + spec.name)
        for spec in getattr(detector.module, "PARAMETERS", ())
    ]
    current = {DETECTOR + name: value for name, value in detector.parameters.items()}
    where = f"{plan.source}: tuning.parameters"
    if not plan.tuning.parameters and not any(spec.is_searched for spec in specs):
        example = next((spec.name for spec in specs if spec.kind == "positive"), "NAME")
        raise InputError(
            f"{where}: is missing; name what is searched, with bounds: {{{example}: [low, high]}}"
            f" (`egolane show {detector.name}` lists the parameters)"
        )
    space = make_space(specs, current, plan.tuning.parameters, 1, where)
    return PictureProblem(plan, settings, detector, camera, clips, space)


def _place(plan: PicturePlan, key: str) -> Path:
    path = plan.folder / Path(getattr(plan.pictures, key)).expanduser()
    if not path.is_file():
        raise InputError(f"{plan.source}: pictures.{key}: no file {path}")
    return path


def _clips(plan: PicturePlan, camera: Camera) -> tuple[Clip, ...]:
    labels = _place(plan, "labels")
    frames = read_labels(labels)
    first, stop = plan.pictures.frames or (0, len(frames))
    if stop > len(frames):
        raise InputError(
            f"{plan.source}: pictures.frames: {[first, stop]}: {labels} has {len(frames)} labelled"
            " pictures"
        )
    pictures = [label_picture(frame, labels) for frame in frames]
    in_folder = Counter(picture.parent for picture in pictures)
    clips = []
    for frame, picture in zip(frames[first:stop], pictures[first:stop], strict=True):
        before: tuple[Path, ...] = (picture,)
        if in_folder[picture.parent] == 1:
            files = open_source(picture.parent).files
            before = files[: files.index(picture) + 1]
        clips.append(Clip(label_places(camera, frame, plan.pictures.ahead_m), before))
    return tuple(clips)


def prepare(
    plan: PicturePlan,
    directory: Path,
    held_out: str = "blocks",
    test: PicturePlan | None = None,
    storage: str | None = None,
) -> PictureSearch:
    """Read the labels and check everything that can be checked before a picture is looked at.

    Raises InputError for whatever does not fit, another study in the same place included.
    """
    problem = make_problem(plan)
    made = PictureSearch(problem, directory, held_out, storage)
    if held_out == "recordings":
        raise InputError(
            f"{plan.source}: whole_recordings: labelled pictures are one recording; their blocks"
            " are held out"
        )
    if held_out == "blocks":
        blocks(len(problem.clips), plan.tuning.blocks)
    made.notes += _starts(problem)[1]
    if test is not None:
        made.test = make_problem(replace(test, tuning=plan.tuning))
        if made.test.space.dimensions != problem.space.dimensions:
            raise InputError(
                f"{test.source}: test_on: declares other parameters than {plan.source}"
            )
    check_place(storage, directory, plan.name, _identity(problem))
    return made


def counts_of(
    problem: PictureProblem, point: Point, which: Sequence[int] | None = None
) -> IntArray:
    """Look at the clips with the parameters of a point: (K, 4), per labelled picture what
    `scoring.line_places.line_counts` counts. which: only these clips."""
    detector = replace(problem.detector, parameters=_parameters(problem, point))
    chosen = range(len(problem.clips)) if which is None else which
    return np.array([_looked_at(problem, detector, problem.clips[k]) for k in chosen])


def _parameters(problem: PictureProblem, point: Point) -> dict[str, Value]:
    values = to_parameters(problem.space, point)
    return {name.removeprefix(DETECTOR): value for name, value in values.items()}


def _looked_at(problem: PictureProblem, detector: Detector, clip: Clip) -> IntArray:
    given = problem.plan.pictures
    pictures = (Picture(k, read_image(path)) for k, path in enumerate(clip.pictures))
    for _, found in detect(detector, problem.camera, pictures):
        lines = found
    x = given.ahead_m
    places = lines.shape @ np.array([1.0, x, x**2 / 2, x**3 / 6])
    if len(clip.pictures) > 1:
        places = places[lines.is_valid]
    return line_counts(clip.label_m, places, given.side_m, given.tolerance_m)


def _scorer(
    problem: PictureProblem, which: Sequence[int] | None = None
) -> Callable[[Point], list[float]]:
    def score(point: Point) -> list[float]:
        total = counts_of(problem, point, which).sum(axis=0)
        return [
            float(np.nan_to_num(LINE_SCORES[name](total))) for name in problem.settings.objectives
        ]

    return score


def _starts(problem: PictureProblem) -> tuple[list[Point], list[str]]:
    """The detector's values before the search, which it tries first, and a note where these lie
    out of bounds."""
    if problem.plan.tuning.from_scratch:
        return [], []
    current = {DETECTOR + name: value for name, value in problem.detector.parameters.items()}
    point = to_point(problem.space, current)
    if point is None:
        return [], ["the current values lie outside of the bounds and are not tried first"]
    return [point], []


def _identity(problem: PictureProblem) -> dict[str, Any]:
    """What makes two studies the same one, as `identity.identity_of`."""
    pictures = {
        **problem.plan.pictures.model_dump(mode="json", exclude={"labels", "camera"}),
        "data": [entry["sha256"][:16] for entry in _data(problem)],
        "code": code_of_detector(problem.detector),
    }
    return search_identity(problem, {problem.plan.name: problem.space}, {"pictures": pictures})


def _data(problem: PictureProblem) -> list[dict[str, Any]]:
    """The `file_entry` of labels, camera and the labelled pictures."""
    pictures = [clip.pictures[-1] for clip in problem.clips]
    files = [_place(problem.plan, "labels"), _place(problem.plan, "camera"), *pictures]
    return [{**file_entry(path, pictures_in), "path": path.name} for path in files]


def tune(
    made: PictureSearch,
    *,
    jobs: Jobs = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Do a search; return what is in its study.json, which it writes.

    - jobs: processes that share the studies without a block.
    - progress: called with the name of a study, the number of trials that it finished since, and
      its best score so far.

    Studies without a block that an earlier command finished are not run again.
    """
    make_directory(made.directory)
    problem, name = made.problem, made.problem.plan.name
    with storage_errors(made.storage):
        storage = open_storage(made.storage, made.directory)
        identity, starts = _identity(problem), _starts(problem)[0]
        study = open_study(storage, name, problem.settings, identity, starts)
        report = counted(progress, problem.settings, name)
        search(study, problem.space, _scorer(problem), problem.settings, report=report)
    made.trials = trials_columns(study, problem.settings.objectives)
    write_trials(made.directory, made.trials)
    best = best_trial(study)
    nested = read_nested(made.directory, made.key)
    left = [part for part in range(made.n_parts) if part not in nested]
    work = functools.partial(_without, pickle.dumps(problem.plan))
    for found in in_order(work, left, jobs):
        nested[found.part] = found
        write_nested(made.directory, made.key, nested)
        if progress is not None:
            progress(f"{name} without block {found.part + 1}", found.trials, found.values[0])
    return _finished(made, study, dict(best.params), nested)


@functools.lru_cache(maxsize=8)
def _loaded(plan: bytes) -> PictureProblem:
    return make_problem(pickle.loads(plan))


def _without(plan: bytes, part: int) -> Nested:
    """Run the study from scratch without a block."""
    problem = _loaded(plan)
    settings = settings_of_part(problem.settings, part)
    parts = blocks(len(problem.clips), problem.plan.tuning.blocks)
    kept = np.concatenate([each for k, each in enumerate(parts) if k != part]).tolist()
    best = best_trial(search_in_memory(problem.space, _scorer(problem, kept), settings))
    return Nested(part, dict(best.params), tuple(best.values), settings.trials)


def _finished(
    made: PictureSearch, study: Any, point: dict[str, Any], nested: Mapping[int, Nested]
) -> dict[str, Any]:
    """Score what was found in-sample and held out, and write study.json and best.yaml."""
    problem = made.problem
    settings, plan = problem.settings, problem.plan
    values = _parameters(problem, point)
    counts = counts_of(problem, point)
    content: dict[str, Any] = {
        **head_of(problem, _identity(problem), _data(problem)),
        "run": None,
        "scores": list(LINE_SCORES),
        "experiments": [
            {"parameters": {DETECTOR + k: v for k, v in problem.detector.parameters.items()}}
        ],
        "best": best_entry(study, settings.objectives, {plan.name: values}),
        "in_sample": {"tuned_on": "same_frames", "all_frames": _assessed(counts)},
        "held_out": None,
        "difference": None,
        "test": None,
        "notes": made.notes,
    }
    if nested:
        parts = blocks(len(problem.clips), plan.tuning.blocks)
        counts_held_out = np.concatenate(
            [counts_of(problem, nested[b].point, part.tolist()) for b, part in enumerate(parts)]
        )
        content["held_out"] = {
            **held_out_entry([nested[b] for b in sorted(nested)], "blocks", [None] * len(nested)),
            "all_frames": _assessed(counts_held_out),
        }
        content["difference"] = {"all_frames": _assessed(counts, counts_held_out)}
    if made.test is not None:
        content["test"] = {
            "tuned_on": "other_frames",
            "name": made.test.plan.name,
            "all_frames": _assessed(counts_of(made.test, point)),
        }
    write_json(made.directory / STUDY_FILE, content)
    searched = {d.parameter.removeprefix(DETECTOR) for d in problem.space.dimensions}
    recording = {
        "detector": plan.pictures.detector,
        "detector_parameters": {k: v for k, v in values.items() if k in searched},
    }
    heading = "# For `include:` in an experiment on pictures.\n"
    made.experiments = {"best.yaml": plain({"recording": recording})}
    write_yaml(made.directory / "best.yaml", made.experiments["best.yaml"], heading)
    return content


def _assessed(counts: IntArray, minus: IntArray | None = None) -> dict[str, Any]:
    """The scores of counts (K, 4), or what they have more than others, with intervals where there
    are pictures enough."""
    found: dict[str, Any] = {"frames_scored": len(counts), "intervals": {}}
    for name, score in LINE_SCORES.items():
        found[name] = float(score(counts.sum(axis=0)))
        if minus is not None:
            found[name] -= float(score(minus.sum(axis=0)))
        bounds = None
        if len(counts) >= 2 * _ALIKE:
            other = None if minus is None else [minus]
            interval: Interval = bootstrap_interval([counts], score, minus=other, block=_ALIKE)
            bounds = [interval.low, interval.high]
        found["intervals"][name] = bounds
    return found
