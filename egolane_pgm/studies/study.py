"""Studies: fit on some frames, infer and score the others.

`fit_folds` and `test_frames` are the only engine. `run --held-out`, `tune`, `learn` and transfer
between drives differ in the fit and in the folds.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.contracts import Graph
from egolane_pgm.drives import Drive, drive_key, read_drives
from egolane_pgm.experiment import DETECTOR, Experiment, TrainedOn, resolved
from egolane_pgm.identity import compared, data_files, digest, most_in_sample, trained_on
from egolane_pgm.model import Model, with_own_values
from egolane_pgm.result import Result, is_result, make_result
from egolane_pgm.running import concat_drives, frames_of, noting
from egolane_pgm.studies.fits import (
    TABLES,
    Fit,
    Fitted,
    apply_fit,
    fit_by_name,
    fit_nothing,
    objective_of_learning,
    posterior_beside_profile,
    search_space,
    strength_of_learning,
    what_is_learned,
)
from egolane_pgm.studies.profile import make_profile, values_of
from egolane_pgm.studies.search import new_study, sampler_name, search, settings_of
from egolane_pgm.studies.space import describe
from egolane_pgm.studies.storage import JOURNAL_NAME
from egolane_pgm.tools.files import (
    check_place,
    make_directory,
    to_jsonable,
    write_json,
    write_parquet,
    write_yaml,
)
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, IntArray, suggestion

#: The default number of blocks.
N_BLOCKS = 5

#: The file that makes the directory of a study complete.
STUDY_FILE = "study.json"


class Fold(NamedTuple):
    """Training and test frames per drive, as indices into its annotated frames."""

    train: tuple[IntArray, ...]
    test: tuple[IntArray, ...]


def everything(drives: Sequence[Drive], *, is_trusted_only: bool = True) -> Fold:
    """The fold of a final fit: train on all trusted frames, or on all; test on all frames."""
    test = tuple(np.arange(len(drive)) for drive in drives)
    trusted = tuple(np.flatnonzero(drive.is_trusted) for drive in drives)
    return Fold(trusted if is_trusted_only else test, test)


def block_folds(drives: Sequence[Drive], n_blocks: int = N_BLOCKS) -> list[Fold]:
    """Hold out each of some contiguous blocks of every drive in turn.

    Blocks are `np.array_split` of the annotated frames, crossing ones included. Raises InputError
    for fewer than 2 blocks, and for more than frames.
    """
    fewest = min(map(len, drives))
    if not 2 <= n_blocks <= fewest:
        raise InputError(f"folds: {n_blocks} is not between 2 and the {fewest} frames of a drive")
    return _folds(drives, [_block_of(len(drive), n_blocks) for drive in drives])


def _block_of(n: int, n_blocks: int) -> IntArray:
    """(n,): the block of each of n frames or drives, as `np.array_split` cuts them."""
    return np.repeat(np.arange(n_blocks), [len(b) for b in np.array_split(np.arange(n), n_blocks)])


def group_folds(drives: Sequence[Drive], groups: Sequence[Any]) -> list[Fold]:
    """Hold out the drives of each group in turn. groups: a label per drive, such as a tag."""
    numbers, _ = pd.factorize(np.array(groups, dtype=object))
    return _folds(drives, [np.full(len(d), k) for d, k in zip(drives, numbers, strict=True)])


def _folds(drives: Sequence[Drive], numbers: Sequence[IntArray]) -> list[Fold]:
    """Hold out each number in turn. numbers: of the fold of each frame, per drive (K,), from 0."""
    pairs = list(zip(drives, numbers, strict=True))
    return [
        Fold(
            tuple(np.flatnonzero((number != b) & drive.is_trusted) for drive, number in pairs),
            tuple(np.flatnonzero(number == b) for number in numbers),
        )
        for b in range(1 + max(map(np.max, numbers)))
    ]


def drive_folds(drives: Sequence[Drive], n_parts: int, tag: str | None = None) -> list[Fold]:
    """Hold out whole drives: those with each value of a tag, or of each of some parts of the list.

    Recordings of one drive are held out together, with the tag of the first one. Raises InputError
    if nothing would be left.
    """
    experiments = [drive.experiment for drive in drives]
    keys = [drive_key(e, list(map(digest, data_files(e)))) for e in experiments]
    groups: list[Any]
    if tag is None:
        unique = list(dict.fromkeys(keys))
        part = _block_of(len(unique), min(n_parts, len(unique)))
        groups = [part[unique.index(key)] for key in keys]
        which = "folds: all rows are of one drive"
    else:
        known = {name for drive in drives for name in drive.tags}
        groups = [drive.tags.get(tag) for drive in drives]
        which = f"by_tag: all have one {tag}"
        for drive, group in zip(drives, groups, strict=True):
            if group is None:
                raise InputError(f"by_tag: {drive.name} has no tag.{tag}{suggestion(tag, known)}")
        groups = [groups[keys.index(key)] for key in keys]
    if len(set(groups)) < 2:
        raise InputError(f"{which}, so nothing would be left to fit to; folds 0 holds out nothing")
    return group_folds(drives, groups)


def fit_fold(
    drives: Sequence[Drive], fit: Fit, numbered: tuple[int | None, Fold]
) -> tuple[Fitted, list[str]]:
    """Fit to the training frames of a numbered fold; the labels of all others are masked.

    Returns the fit and its warnings, which another process cannot show.
    """
    number, fold = numbered
    used = [k for k, train in enumerate(fold.train) if len(train)]
    if fit is not fit_nothing:
        check_trained(fold, number)
    train = [fold.train[k] for k in used]
    with noting() as notes:
        fitted = fit([drives[k].mask_labels(fold.train[k]) for k in used], train, number)
    return fitted, notes


def check_trained(fold: Fold, number: int | None) -> None:
    """Raise InputError, with the number of the fold, if it has no training frame."""
    if not any(map(len, fold.train)):
        which = "" if number is None else f"block {number + 1}: "
        raise InputError(
            f"{which}no frame is left to fit to; exclude fewer frames (fit.untrusted_frames)"
        )


def fit_folds(
    drives: Sequence[Drive],
    fit: Fit,
    folds: Sequence[tuple[int | None, Fold]],
    *,
    jobs: int = 1,
    cluster: str | None = None,
) -> list[Fitted]:
    """The fit of each numbered fold; see `fit_fold`."""
    work = partial(fit_fold, list(drives), fit)
    found = parallel(work, folds, jobs=jobs, cluster=cluster)
    fitted = []
    for fold, notes in bar(found, total=len(folds), unit="fit"):
        fitted.append(fold)
        for note in notes:
            warnings.warn(note, UserWarning, stacklevel=2)
    return fitted


def test_frames(
    drives: Sequence[Drive], folds: Sequence[Fold], fitted: Sequence[Fitted]
) -> pd.DataFrame:
    """The table of all test frames, in order, with the fold number in column `block`.

    Each drive is filtered from its first frame on, with the fit of the frame's fold.
    """
    tables = []
    for k, drive in enumerate(drives):
        inferred: dict[frozenset[Any], pd.DataFrame] = {}
        parts = []
        for b in (b for b, fold in enumerate(folds) if len(fold.test[k])):
            fit = frozenset(fitted[b].items())
            if fit not in inferred:
                inferred[fit] = inferred_frames(fitted_drive(drive, fitted[b]))
            parts.append(inferred[fit].iloc[drive.rows[folds[b].test[k]]].assign(block=b))
        tables.append(pd.concat(parts).sort_index())
    return concat_drives(drives, tables)


def inferred_frames(drive: Drive) -> pd.DataFrame:
    """The table of all frames of a drive; with `is_trusted` if some labels are not."""
    frames = frames_of(drive)
    if not drive.is_trusted.all():
        trusted = np.ones(len(frames), dtype=bool)
        trusted[drive.rows] = drive.is_trusted
        frames["is_trusted"] = trusted
    return frames


def fitted_drive(
    drive: Drive, fitted: Fitted, trained: tuple[TrainedOn, ...] | None = None
) -> Drive:
    """The drive with a fit in its model; other detector parameters detect its lines again.

    - trained: the training drives of a final fit, whose experiment has the fitted numbers.
    """
    model = apply_fit(drive.model, fitted)
    if trained is not None:
        has_tables = any(name.startswith(TABLES) for name in fitted)
        model = with_own_values(model, trained, has_tables=has_tables)
    if model.experiment.parameters.get(DETECTOR) == drive.experiment.parameters.get(DETECTOR):
        return replace(drive, model=model)
    [again] = read_drives(model.experiment)
    return replace(again, model=model)


# --- studies -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A fit to some drives, with scores on held-out frames.

    - name: of the experiment, or of a list of them.
    - experiments: the fitted experiments.
    - method: learn or tune.
    - fitted: parameters and tables of the final fit, to all trusted frames, by name.
    - in_sample: the result of the training frames, with `fitted`.
    - held_out: the result of the test frames of all folds, each with the fit of its fold; None
      without folds.
    - trials: a row per trial of the final search; empty without one.
    - profile: of parameters, see `profile.make_profile`; empty without one.
    - posterior: of parameters that were fitted to labels, see `fits.posterior_of`; else empty.
    - settings: of the search.
    - directory: the study directory; None in memory.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> changes = {"fit.sampler": "random"}
    >>> study = ego.tune(experiment, trials=4, overrides=changes, folds=0)
    >>> study
    Study('quickstart': tune, 4 trials, accuracy 0.969 in-sample)
    >>> sorted(study.fitted)[:2]
    ['bonus_value', 'p1']
    """

    name: str
    experiments: Sequence[Experiment]
    method: str
    fitted: Fitted
    in_sample: Result
    held_out: Result | None = None
    trials: pd.DataFrame = field(default_factory=pd.DataFrame)
    settings: Mapping[str, Any] = field(default_factory=dict)
    directory: Path | None = None
    profile: pd.DataFrame = field(default_factory=pd.DataFrame)
    posterior: pd.DataFrame = field(default_factory=pd.DataFrame)

    def __repr__(self) -> str:
        from egolane_pgm.views.studies import study_title

        return f"Study({study_title(self)})"

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.in_sample.model

    @property
    def n_trials(self) -> int:
        """The number of complete trials."""
        return int((self.trials["state"] == "COMPLETE").sum()) if len(self.trials) else 0

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        found = [*self.in_sample.notes, *(self.held_out.notes if self.held_out else ())]
        return list(dict.fromkeys(found))

    @property
    def experiment(self) -> Experiment:
        """The fitted experiment, on the first of the recordings."""
        first, suffix = self.in_sample.experiment, "tuned" if self.method == "tune" else "learned"
        about = f"{first.description}; fitted by {self.method}".lstrip("; ")
        names = {"name": f"{self.name}_{suffix}", "description": about}
        return first.model_copy(update=names)

    def to_text(self, *, style: str = "markdown") -> str:
        """The text that `egolane tune` prints: scores in-sample and held out, and fitted values.

        - style: one of `views.tables.STYLES`.
        """
        from egolane_pgm.views.studies import study_text

        return study_text(self, style)

    def save(self, directory: str | os.PathLike[str]) -> Path:
        """Write best.yaml (the fitted experiment), study.json, trials.parquet and held_out/.

        Learned tables are in best.graph.yaml, a profile in profile.parquet, a posterior in
        posterior.parquet. study.json is written last.
        """
        place = Path(directory)
        make_directory(place)
        (place / STUDY_FILE).unlink(missing_ok=True)
        content, graph = resolved(self.experiment, self.model.parameters), self.experiment.graph
        if isinstance(graph, Graph):
            drives = ", ".join(each.name for each in self.experiments)
            about = {"description": f"tables learned from {drives}"}
            write_yaml(place / "best.graph.yaml", {**about, **(graph.keys or {})})
            content["graph"] = "./best.graph.yaml"
        write_yaml(place / "best.yaml", content)
        for name in ("trials", "profile", "posterior"):
            rows = getattr(self, name)
            (place / f"{name}.parquet").unlink(missing_ok=True)
            if len(rows):
                write_parquet(place / f"{name}.parquet", rows)
        if self.held_out is not None:
            self.held_out.save(place / "held_out")
        write_json(place / STUDY_FILE, self.document)
        return place

    @property
    def document(self) -> dict[str, Any]:
        """The content of study.json."""
        held_out = self.held_out
        found: dict[str, Any] = {
            "name": self.name,
            "method": self.method,
            "experiments": [each.name for each in self.experiments],
            "settings": self.settings,
            "fitted": dict(self.fitted),
            "run": {k: v for k, v in self.in_sample.run.items() if k != "values"},
            "in_sample": self.in_sample.scores,
            "held_out": None if held_out is None else held_out.scores,
            "folds": None if held_out is None else held_out.run["fitted"],
        }
        content: dict[str, Any] = to_jsonable(found)
        return content


def is_study(directory: str | os.PathLike[str]) -> bool:
    """Whether a directory holds a complete study."""
    return (Path(directory) / STUDY_FILE).is_file()


def held_out_result(
    experiment: Experiment,
    drives: Sequence[Drive],
    folds: Sequence[Fold],
    fitted: Sequence[Fitted],
    notes: Sequence[str],
    begin: float,
    fit: str,
) -> Result:
    """The result of the test frames of all folds."""
    with noting() as found:
        frames = test_frames(drives, folds, fitted)
    keys = {"blocks": len(folds), "fitted": [dict(each) for each in fitted], "fit": fit}
    keys["free_parameters"] = apply_fit(drives[0].model, fitted[0]).free_parameters
    if fit != "none":
        keys["tuned_on"] = most_in_sample(
            compared(trained, drive.marks, drive.frame_ids(test))
            for fold in folds
            for trained in training_of_fold(drives, fold)
            for drive, test in zip(drives, fold.test, strict=True)
            if len(test)
        )
    notes = [*notes, *found]
    return make_result(experiment, drives, frames, notes, begin=begin, **keys)


def training_of_fold(drives: Sequence[Drive], fold: Fold) -> tuple[TrainedOn, ...]:
    """What a fit to the training frames of a fold keeps of each drive."""
    pairs = zip(drives, fold.train, strict=True)
    return tuple(
        trained_on(drive.marks, drive.frame_ids(train)) for drive, train in pairs if len(train)
    )


def run_held_out(
    drives: Sequence[Drive],
    n_blocks: int = N_BLOCKS,
    *,
    experiment: Experiment | None = None,
    notes: Sequence[str] = (),
) -> Result:
    """Infer each block of some drives with a fit (`fit.method`) to the other blocks.

    - experiment: by default that of the first drive.
    """
    begin, experiment = time.perf_counter(), experiment or drives[0].experiment
    method = experiment.fit.method
    check_labels(drives, method)
    folds, fit = block_folds(drives, n_blocks), fit_by_name(method)
    with noting() as found:
        fitted = fit_folds(drives, fit, list(enumerate(folds)))
    notes = [*notes, *found]
    return held_out_result(experiment, drives, folds, fitted, notes, begin, method)


class Work(NamedTuple):
    """Where and how a study runs.

    - directory: of the study, which is saved there; None for a study in memory.
    - storage: Optuna's storage of a study per fold; by default a journal in `directory`, or memory.
    - pooled: whether all frames count alike in a search; otherwise all drives do.
    - jobs, cluster: see `tools.jobs.parallel`.
    """

    directory: Path | None = None
    storage: str | None = None
    pooled: bool = False
    jobs: int = 1
    cluster: str | None = None


def run_study(
    drives: Sequence[Drive],
    method: str,
    folds: Sequence[Fold],
    work: Work = Work(),  # noqa: B008
    *,
    name: str | None = None,
    experiments: Sequence[Experiment] | None = None,
    starts: Sequence[Mapping[str, Any]] | None = None,
    profile: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Study:
    """Fit to everything, and hold out each fold in turn.

    - method: learn or tune.
    - folds: empty for no held-out scores.
    - name: of the study; by default the first experiment's.
    - experiments: by default the experiments of the drives.
    - starts: parameter sets that the final search tries first; by default the current ones.
    - profile: parameters of a search whose profile is made.
    """
    begin = time.perf_counter()
    check_labels(drives, method)
    if experiments is None:
        experiments = list(dict.fromkeys(drive.experiment for drive in drives))
    if work.directory is not None:
        check_directory(work.directory)
        work = work._replace(storage=work.storage or str(work.directory / JOURNAL_NAME))
    settings = settings_of_study(drives, method, profile)
    starts = [drive.model.parameters for drive in drives] if starts is None else list(starts)
    fit = fit_by_name(method, storage=work.storage, starts=starts, pooled=work.pooled)
    # As in the paper, the search on everything uses all frames; no held-out score does.
    whole_fold = everything(drives, is_trusted_only=method == "learn")
    numbered = [(None, whole_fold), *enumerate(folds)]
    shared: Any = {"jobs": work.jobs, "cluster": work.cluster}
    with noting() as of_fits:
        whole, *fitted = fit_folds(drives, fit, numbered, **shared)
        trained = training_of_fold(drives, whole_fold)
        final = [fitted_drive(drive, whole, trained) for drive in drives]
        frames = concat_drives(final, [inferred_frames(drive) for drive in final])
    notes = [*notes, *of_fits]
    trials = pd.DataFrame() if whole.trials is None else whole.trials
    posterior = whole.posterior
    profiled = pd.DataFrame()
    if profile:
        shared |= {"pooled": work.pooled, "directory": work.directory}
        profiled = make_profile(drives, profile, trials, **shared)
        posterior = posterior_beside_profile(drives, whole_fold.train)
    held_out = None
    in_sample = make_result(final[0].experiment, final, frames, notes, begin=begin)
    if folds:
        held_out = held_out_result(experiments[0], drives, folds, fitted, notes, begin, method)
    study = Study(
        name=name or experiments[0].name,
        experiments=experiments,
        method=method,
        fitted=whole,
        in_sample=in_sample,
        held_out=held_out,
        trials=trials,
        settings=settings,
        directory=work.directory,
        profile=profiled,
        posterior=pd.DataFrame() if posterior is None else posterior,
    )
    if work.directory is not None:
        study.save(work.directory)
    return study


def check_directory(directory: Path) -> None:
    """Raise InputError if a study cannot be written to a directory."""
    if is_result(directory):
        raise InputError(f"{directory}: is a result directory; name another one")
    check_place(directory / STUDY_FILE)


def settings_of_study(
    drives: Sequence[Drive], method: str, profile: Sequence[str]
) -> dict[str, Any]:
    """Return the settings of a study. Raises InputError if they do not fit, before anything is
    written."""
    first = drives[0]
    if method == "learn":
        learns = what_is_learned(first.model)
        kept = {"labels", "strength", "block", "trials", "seed"}
        settings = {"learns": learns, **first.experiment.fit.model_dump(include=kept)}
        if learns != "rule":
            objective = objective_of_learning(first.model)
            settings["objective"] = objective
            settings["strength"] = strength_of_learning(first.model, objective, ())
        return settings
    tuning = settings_of(first.experiment.fit, None, first.experiment.source)
    space = search_space([drive.model for drive in drives], tuning)
    for each in profile:
        values_of(space, each)
    # A sampler that does not fit shows it in a trial.
    once = tuning.model_copy(update={"trials": 1})
    search(new_study(once), space, lambda point: [0.0] * len(tuning.scores), once)
    settings = {"objectives": tuning.scores, "sampler": sampler_name(tuning.sampler)}
    return settings | tuning.model_dump(include={"trials", "seed"}) | describe(space)


def check_labels(drives: Sequence[Drive], method: str) -> None:
    """Raise InputError for a drive without the ground truth that a fit needs."""
    for drive in drives:
        e = drive.experiment
        if e.filter == "viterbi":
            raise InputError(
                f"{e.source}: filter: viterbi is for `egolane run`; fits and held-out scores need"
                " another one"
            )
        is_by_em = method == "learn" and what_is_learned(drive.model) != "rule"
        is_of_lines = method == "tune" and e.fit.objective == ("log_evidence",)
        if method == "none" or is_of_lines or (is_by_em and not e.fit.labels):
            continue
        if not drive.has_truth:
            what = "a search needs it" if method == "tune" else "learning needs it"
            raise InputError(f"{e.source}: ground_truth: is missing, {what}")
        if drive.is_crossing[drive.rows].all():
            raise InputError(f"{e.source}: every annotated frame is a crossing, nothing to score")
