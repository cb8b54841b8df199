"""One experiment on one recording, each block of the drive believed with parameters that have not
seen it. How parameters are found is the experiment's `fit`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.compare.choose import (
    Losses,
    choose,
    experiment_key,
    learns,
    plan,
    settings_of,
    try_all,
)
from egolane_pgm.compare.learned_on import learner_elsewhere
from egolane_pgm.compare.placing import Found, believe, drive_key
from egolane_pgm.experiment import Experiment, Tuning
from egolane_pgm.learn import check_learnable, n_learned, with_found
from egolane_pgm.learn import fit as learn_from
from egolane_pgm.loading import Recorded
from egolane_pgm.model import Drive, declared_parameters, may_fit, value_names
from egolane_pgm.scoring.held_out import N_BLOCKS, held_out
from egolane_pgm.tune.objective import check_objective, scores_of
from egolane_pgm.tune.space import Point, SearchSpace, make_space, to_parameters
from egolane_pgm.tune.study import Settings, best_trial, check_sampler, run_study
from egolane_pgm.types import Beliefs, BoolArray, FloatArray, InputError, IntArray, LaneTruth

#: Trials of each block's search where nothing else is said; a study of its own takes more.
TRIALS = 300

#: Frames that are filtered once before time is taken: kernels are compiled or loaded.
_WARM_UP = 50

#: Times that the whole recording is filtered where one would do, for the time it takes.
_TIMED = 3

Fit = Callable[[IntArray], Found]


@dataclass(frozen=True)
class HeldOutRun:
    """What an experiment believes in the K annotated frames of its recording.

    truth: of these frames. may_fit (K,): frames outside of `tuning.never_fit`. belief (K, n),
    log_evidence (K,), is_impossible (K,): stitched over the blocks. bad (K,): P(SensorState =
    BAD), or None for a graph without it. parameters: per block what was fitted without it.
    free_parameters: numbers that were fitted to labels. seconds_per_frame: processor time of
    evidence and filter over the whole recording, the fastest of several. tuned_on: as in a YAML.
    notes: what the evidence rule said.
    """

    experiment: Experiment
    recorded: Recorded
    truth: LaneTruth
    may_fit: BoolArray
    belief: FloatArray
    log_evidence: FloatArray
    is_impossible: BoolArray
    bad: FloatArray | None
    parameters: tuple[Found, ...]
    free_parameters: int
    seconds_per_frame: float
    tuned_on: str
    notes: tuple[str, ...] = ()


def held_out_run(
    drive: Drive,
    *,
    n_blocks: int = N_BLOCKS,
    trials: int | None = None,
    losses: Sequence[Losses] | None = None,
) -> HeldOutRun:
    """Fit without each block in turn, filter the whole recording, keep the block.

    trials: of each block's search with `fit: tune`; default the experiment's, else TRIALS. losses:
    of the settings of `fit: choose`, where they are at hand. Raises InputError for a fit that the
    experiment's plugins do not allow, or too many blocks.
    """
    experiment, recorded, n_frames = drive.experiment, drive.recorded, len(drive)
    fit, free_parameters = _fit_of(drive, n_blocks, trials, losses)
    names = value_names(drive.model).get("SensorState", [])
    stitched: list[Beliefs] = []
    notes: list[str] = []
    seconds: list[float] = []
    believe(drive, drive.model, slice(0, _WARM_UP))

    def predict(found: Found) -> FloatArray:
        if not (experiment.fit == "none" and len(stitched) >= _TIMED):
            begun = time.process_time()
            changed = with_found(drive.model, found, experiment)
            beliefs, said = believe(drive, changed, slice(None))
            notes.extend(said)
            seconds.append((time.process_time() - begun) / len(recorded.log))
            stitched.append(beliefs)
        else:
            stitched.append(stitched[0])
        return stitched[-1].lane[recorded.scored]

    trusted = may_fit(drive)
    result = held_out(n_frames, n_blocks, fit, predict, fit_exclude=~trusted)

    def pick(values: Callable[[Beliefs], np.ndarray]) -> np.ndarray:
        each = np.stack([values(beliefs)[recorded.scored] for beliefs in stitched])
        return np.asarray(each[result.block, np.arange(n_frames)])

    at = names.index("BAD") if "BAD" in names else None
    return HeldOutRun(
        experiment,
        recorded,
        drive.truth,
        trusted,
        result.belief,
        pick(lambda b: b.log_evidence),
        pick(lambda b: b.is_impossible),
        None if at is None else pick(lambda b: b.marginals["SensorState"][:, at]),
        result.parameters,
        free_parameters,
        min(seconds),
        experiment.tuned_on if experiment.fit == "none" else "other_frames",
        tuple(dict.fromkeys(notes)),
    )


def _fit_of(
    drive: Drive, n_blocks: int, trials: int | None, losses: Sequence[Losses] | None
) -> tuple[Fit, int]:
    """The fit, a function of the training frames, and how many numbers it finds."""
    experiment, model = drive.experiment, drive.model
    if experiment.learned_on and experiment.fit != "learn":
        raise InputError(f"{experiment.source}: learned_on: goes with fit: learn")
    if experiment.fit == "none":
        if experiment.tuned_on == "not_tuned":
            return (lambda train: {}), 0
        searched = [
            spec.name
            for spec in declared_parameters(model.rule, model.graph)
            if spec.search is not None
        ]
        return (lambda train: {}), sum(np.size(model.parameters[name]) for name in searched)
    if experiment.fit == "learn":
        check_learnable(model, experiment)
        numbers = n_learned(model, experiment)
        if experiment.learned_on:
            return learner_elsewhere(drive, n_blocks), numbers
        return (lambda train: learn_from(model, drive.recorded, train, experiment)), numbers
    if experiment.fit == "choose":
        numbers = len(settings_of(experiment)[0])
        if learns(model, experiment):
            numbers += n_learned(model, experiment)
        return _chooser(drive, n_blocks, losses), numbers
    space, settings = _search(drive, trials)
    return _tuner(drive, space, settings), len(space)


def _chooser(drive: Drive, n_blocks: int, losses: Sequence[Losses] | None) -> Fit:
    """The setting that is best without the block, and what is learned with it."""
    experiment = drive.experiment
    if losses is None:
        tasks = plan([experiment], n_blocks)
        losses = list(try_all(tasks[experiment_key(experiment)]))
    settings, part = settings_of(experiment), itertools.count()

    def fit(train: IntArray) -> Found:
        setting = settings[choose(losses, drive_key(experiment), next(part), experiment)]
        model = with_found(drive.model, setting, experiment)
        if not learns(model, experiment):
            return setting
        return {**setting, **learn_from(model, drive.recorded, train, experiment)}

    return fit


def _search(drive: Drive, trials: int | None) -> tuple[SearchSpace, Settings]:
    experiment = drive.experiment
    if not experiment.is_causal:
        raise InputError(
            f"{experiment.source}: fit: tune searches with filter assumed_density or exact, not"
            f" {experiment.filter}"
        )
    tuning = experiment.tuning or Tuning()
    where = f"{experiment.source}: tuning"
    names = tuple(check_objective(n, f"{where}.objective") for n in tuning.objective)
    sampler = check_sampler(tuning.sampler, names, f"{where}.sampler")
    specs = declared_parameters(drive.model.rule, drive.model.graph)
    space = make_space(
        specs, drive.model.parameters, tuning.parameters, drive.n_lanes, f"{where}.parameters"
    )
    return space, Settings(names, sampler, trials or tuning.trials or TRIALS, tuning.seed)


def _tuner(drive: Drive, space: SearchSpace, settings: Settings) -> Fit:
    """A search from scratch: the experiment's own values may have been tuned on the block."""
    part = itertools.count(1)

    def fit(train: IntArray) -> Found:
        used = np.zeros(len(drive), dtype=bool)
        used[train] = True

        def evaluate(points: list[Point]) -> FloatArray:
            sets = [to_parameters(space, point) for point in points]
            return scores_of([drive], [sets], [used], settings.objectives)

        # Another seed for each block: equal searches would share their luck.
        seed = np.random.SeedSequence([settings.seed, next(part)]).generate_state(1)[0]
        study = run_study(space, evaluate, replace(settings, seed=int(seed)))  # type: ignore[arg-type]
        return to_parameters(space, best_trial(study).params)

    return fit
