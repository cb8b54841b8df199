"""One side of a comparison: an experiment on one recording, each block of the drive believed with
parameters that have not seen it. How parameters are found is the experiment's `fit`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.comparing.lags import Lagged, lag_notes, lagged_beliefs
from egolane_pgm.drive import Drive, beliefs_of
from egolane_pgm.experiment import Experiment, Tuning
from egolane_pgm.learning import Found, check_learnable, n_learned, with_found
from egolane_pgm.learning import fit as learn_from
from egolane_pgm.model import value_names
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.scoring.held_out import N_BLOCKS, HeldOut, held_out, without_block
from egolane_pgm.tuning.nested import blocks_lacking_lanes, nested_search
from egolane_pgm.tuning.objective import check_filter
from egolane_pgm.tuning.plan import Plan, Problem, parameters_at, problem_of
from egolane_pgm.types import Beliefs, FloatArray, InputError, IntArray, LaneTruth

#: Trials of each block's search where nothing else is said; a study of its own takes more.
TRIALS = 300

#: Repetitions when timing evidence and filter.
_TIMED = 3

#: Parameters from the drive without a block's labels, the frames to fit on, and the block.
Fit = Callable[[Drive, IntArray, int], Found]


@dataclass(frozen=True)
class Side:
    """What an experiment believes in the K annotated frames of its recording.

    drive: the experiment with its recording, all labels included.
    held_out: the beliefs, and per block what was fitted without it.
    free_parameters: how many numbers were fitted to labels.
    fixed_parameters: how many numbers a search held fixed; None without a search.
    trials: of each block's search; None without one.
    seed: of the search; None without one.
    seconds_per_frame: processor time of evidence and filter over the whole recording, the fastest
        of several.
    tuned_on: as in a YAML.
    notes: what the evidence rule warned of, and blocks that lack a lane, a line each.
    lagged: the beliefs that wait, for each requested lag.
    """

    drive: Drive
    held_out: HeldOut[Found]
    free_parameters: int
    seconds_per_frame: float
    tuned_on: str
    notes: tuple[str, ...] = ()
    fixed_parameters: int | None = None
    trials: int | None = None
    seed: int | None = None
    lagged: tuple[Lagged, ...] = ()

    @property
    def experiment(self) -> Experiment:
        """The experiment, on its recording."""
        return self.drive.experiment

    @property
    def truth(self) -> LaneTruth:
        """The ground truth of the K annotated frames."""
        return self.drive.truth

    @property
    def beliefs(self) -> Beliefs:
        """The beliefs of the K annotated frames, each block with its own parameters."""
        return self.held_out.beliefs

    @property
    def bad(self) -> FloatArray | None:
        """(K,): P(SensorState = BAD); None for a graph without it."""
        names = value_names(self.drive.model).get("SensorState", [])
        if "BAD" not in names:
            return None
        return self.beliefs.marginals["SensorState"][:, names.index("BAD")]


@dataclass(frozen=True)
class Search:
    """How the search of `fit: tune` is done, as far as the experiment does not say it.

    trials: of each block's search; None for the experiment's, else TRIALS.
    trials_per_number: instead, this many for each number that is searched, so that models with more
        numbers are searched as well.
    seed: None for the experiment's.
    """

    trials: int | None = None
    trials_per_number: int | None = None
    seed: int | None = None


def search_problem(drive: Drive, how: Search) -> Problem:
    """What a search is to find for a drive. Raises InputError for an experiment that cannot be
    searched."""
    experiment = drive.experiment
    check_filter(experiment)
    tuning = experiment.tuning or Tuning()
    if "detector" in tuning.search:
        raise InputError(
            f"{experiment.source}: tuning.search: detector: goes with `egolane tune`, not with"
            " fit: tune"
        )
    seed = tuning.seed if how.seed is None else how.seed
    trials = how.trials or tuning.trials or TRIALS
    tuning = tuning.model_copy(update={"trials": trials, "seed": seed})
    searched = Plan(experiment.name, "", (experiment,), tuning, experiment.source)
    problem = problem_of(searched, [drive])
    if how.trials_per_number is None:
        return problem
    trials = how.trials_per_number * len(problem.space)
    return replace(problem, settings=replace(problem.settings, trials=trials))


def search_blocks(drive: Drive, n_blocks: int, how: Search) -> list[Found]:
    """What a search finds without each block in turn, for `held_out_side`. Raises InputError as
    that does."""
    fit = _searcher(search_problem(drive, how))
    return [fit(*without_block(drive, n_blocks, b), b) for b in range(n_blocks)]


def held_out_side(
    drive: Drive,
    *,
    n_blocks: int = N_BLOCKS,
    search: Search | None = None,
    searched: Sequence[Found] | None = None,
    lags: Sequence[float] = (),
) -> Side:
    """Fit without each block in turn, filter the whole recording, keep the block.

    search: how `fit: tune` searches.
    searched: what `search_blocks` found, where it is at hand.
    lags: seconds, increasing: additional beliefs wait this long for later frames.

    Raises InputError for a fit that the experiment's plugins do not allow, too many blocks, or
    lags where the evidence allows none.
    """
    experiment = drive.experiment
    problem = search_problem(drive, search or Search()) if experiment.fit == "tune" else None
    if problem is not None:
        fit, free_parameters = _searcher(problem, searched), len(problem.space)
    else:
        fit, free_parameters = _fit_of(drive)
    done: list[Beliefs] = []
    notes = blocks_lacking_lanes(drive, n_blocks) if experiment.fit != "none" else []
    seconds: list[float] = []

    def beliefs_with(found: Found) -> Beliefs:
        if experiment.fit == "none" and len(done) >= _TIMED:
            return done[0]
        begun = time.process_time()
        beliefs, warned = beliefs_of(drive, with_found(drive.model, found, experiment))
        seconds.append((time.process_time() - begun) / len(drive.recorded.log))
        done.append(beliefs)
        notes.extend(warned)
        return beliefs

    believed = held_out(drive, fit, beliefs_with, n_blocks)
    lagged = lagged_beliefs(drive, believed, lags) if lags else []
    notes += lag_notes(drive, lags) if lags else []
    return Side(
        drive,
        believed,
        free_parameters,
        min(seconds),
        experiment.tuned_on if experiment.fit == "none" else "other_frames",
        tuple(dict.fromkeys(notes)),
        None if problem is None else problem.spaces[0].n_fixed,
        None if problem is None else problem.settings.trials,
        None if problem is None else problem.settings.seed,
        tuple(lagged),
    )


def _fit_of(drive: Drive) -> tuple[Fit, int]:
    """The experiment's way to find parameters without a search, and how many numbers it finds."""
    experiment, model = drive.experiment, drive.model
    if experiment.fit == "none":
        specs = declared_parameters(model.rule, model.graph)
        searched = [spec.name for spec in specs if spec.is_searched]
        numbers = sum(np.size(model.parameters[name]) for name in searched)
        return _nothing, 0 if experiment.tuned_on == "not_tuned" else numbers
    check_learnable(model, experiment)
    return _learn, n_learned(model, experiment)


def _nothing(drive: Drive, train: IntArray, block: int) -> Found:
    return {}


def _learn(drive: Drive, train: IntArray, block: int) -> Found:
    return learn_from(drive, train)


def _searcher(problem: Problem, searched: Sequence[Found] | None = None) -> Fit:
    """A search from scratch: the experiment's own values may have been tuned on the block."""

    def fit(drive: Drive, train: IntArray, block: int) -> Found:
        if searched is not None:
            return searched[block]
        used = np.isin(np.arange(len(drive)), train)
        found = nested_search(replace(problem, drives=(drive,)), [used], block)
        return parameters_at(problem, found.point)[0]

    return fit
