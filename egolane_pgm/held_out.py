"""What an experiment believes about frames that its parameters have not seen: a `Result` as any.

Each block of a drive is believed with parameters that were fitted without its labels, as the
experiment's `fit` says: searched (tune), learned (learn), or none, its own.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.drive import Drive, evidence_on, load_drive
from egolane_pgm.experiment import Experiment, Tuning, resolved
from egolane_pgm.inference.events import across_lanes
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.learning import Found, check_learnable, n_learned, with_found
from egolane_pgm.learning import fit as learn_from
from egolane_pgm.learning.tables import learning_of
from egolane_pgm.model import causality, place_by_lines
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.recordings.source import Read
from egolane_pgm.results import Result
from egolane_pgm.running import Believed, result_rows, run_document, scores_document
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.held_out import N_BLOCKS, held_out
from egolane_pgm.tools.files import plain
from egolane_pgm.tuning.nested import blocks_lacking_lanes, nested_search
from egolane_pgm.tuning.objective import check_filter
from egolane_pgm.tuning.plan import Plan, Problem, parameters_at, problem_of
from egolane_pgm.types import Beliefs, FloatArray, InputError, IntArray

#: Trials of each block's search where nothing else is said; a study of its own takes more.
TRIALS = 300

#: Repetitions when timing evidence and filter.
_TIMED = 3

#: Parameters from the drive without a block's labels, the frames to fit on, and the block.
Fit = Callable[[Drive, IntArray, int], Found]


def run_held_out(
    experiment: Experiment, *, n_blocks: int = N_BLOCKS, read: Read | None = None
) -> Result:
    """Run an experiment, each block of its drive with what was fitted without the block.

    - read: lines and lanes in memory, as `running.run_experiment` takes them.

    The result is that of the K annotated frames (without ground truth: of all), with the `block` of
    each. Its run.json has in addition `fit`, `blocks`, `parameters_per_block`, `never_fit` (ranges
    of frames whose labels are not trusted), `free_parameters` (how many numbers were fitted to
    labels), `microseconds_per_frame` (processor time of evidence and filter, the fastest of
    several), and of a search `fixed_parameters` (how many numbers it held fixed), `trials` and
    `seed`. Its scores leave out the frames of `never_fit`; with them they are `model_all_frames`.

    Raises InputError as `load_drive`, for a fit that the experiment's plugins do not allow, and for
    too many blocks.
    """
    begun = time.perf_counter()
    needs = "a search needs it" if experiment.fit == "tune" else None
    if experiment.fit == "learn" and learning_of(experiment).labels:
        needs = "learning needs it"
    drive = load_drive(experiment, needs_truth=needs, read=read)
    result = held_out_result(drive, n_blocks=n_blocks)
    seconds = round(time.perf_counter() - begun, 3)
    return replace(result, run={**result.run, "seconds": seconds})


def held_out_result(
    drive: Drive,
    *,
    n_blocks: int = N_BLOCKS,
    done: Callable[[], object] = int,
) -> Result:
    """`run_held_out` of a drive.

    - done: is called after each fit.
    """
    experiment = drive.experiment
    fit, facts = _fit_of(drive)
    notes: list[str] = []
    if experiment.fit != "none" and drive.recorded.truth is not None:
        notes += blocks_lacking_lanes(drive, n_blocks)
    believed: list[Beliefs] = []
    tentative: list[FloatArray | None] = []
    seconds: list[float] = []

    def fitted(others: Drive, train: IntArray, block: int) -> Found:
        found = fit(others, train, block)
        done()
        return found

    def beliefs_with(found: Found) -> Beliefs:
        if experiment.fit == "none" and len(believed) >= _TIMED:
            tentative.append(tentative[0])
            return believed[0]
        begun = time.process_time()
        model, log = with_found(drive.model, found, experiment), drive.recorded.log
        method, lag = experiment.filter, experiment.lag
        output = evidence_on(drive, model)
        beliefs = infer_beliefs(model.compiled, output.filtered, method, lag, frame_id=log.frame_id)
        seconds.append((time.process_time() - begun) / len(log))
        tentative.append(None if output.tentative is None else output.tentative[drive.rows])
        notes.extend(output.notes)
        believed.append(beliefs.take(drive.rows))
        return believed[-1]

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        found = held_out(drive, fitted, beliefs_with, n_blocks)
    notes += [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    places = place_by_lines(drive.model)(drive.recorded.log)
    own = [each[found.block == b] for b, each in enumerate(tentative) if each is not None]
    of_beliefs = Believed(
        found.beliefs,
        assigned_lane(found.beliefs.lane, experiment.unassigned_below),
        np.concatenate(own) if own else None,
        **across_lanes(found.beliefs.marginals, None if places is None else places[drive.rows]),
        notes=tuple(dict.fromkeys(notes)),
    )
    run = {
        "blocks": n_blocks,
        "parameters_per_block": [dict(each) for each in found.parameters],
        "tuned_on": experiment.tuned_on if experiment.fit == "none" else "other_frames",
        **causality(experiment, drive.model, found.parameters),
        "never_fit": drive.never_fit,
        "microseconds_per_frame": 1e6 * min(seconds),
        **facts,
    }
    return _result(drive, of_beliefs, found.block, run)


def _result(drive: Drive, believed: Believed, block: IntArray, said: Mapping[str, Any]) -> Result:
    """The result of beliefs about the annotated frames.

    - said: further keys of run.json.
    """
    trusted, fit = drive.may_fit, {"fit": drive.experiment.fit}
    log, rows = drive.recorded.log, drive.rows
    # Results of one recording share its lines where every frame is annotated.
    log = log if len(rows) == len(log) else log.take(rows)
    recorded = replace(drive.recorded, log=log, scored=np.arange(len(rows)))
    drive = replace(drive, recorded=recorded)
    result = result_rows(drive, believed)
    document = run_document(drive, result, [*recorded.notes, *believed.notes], **fit)
    run = plain({**document, **fit, **said})
    config = plain({**resolved(drive.experiment, drive.model.parameters), **fit})
    result = replace(result, run=run, config=config, block=block)
    scores = scores_document(result, drive, trusted)
    if result.truth is not None and not trusted.all():
        scores["model_all_frames"] = scores_document(result, drive)["model"]
    return replace(result, scores=plain(scores))


# --- what is fitted ----------------------------------------------------------------------------


def _fit_of(drive: Drive) -> tuple[Fit, dict[str, Any]]:
    """How the experiment finds parameters, and what run.json says of that."""
    experiment, model = drive.experiment, drive.model
    if experiment.fit == "tune":
        problem = _problem(drive)
        return _searcher(problem), {
            "free_parameters": len(problem.space),
            "fixed_parameters": problem.spaces[0].n_fixed,
            "trials": problem.settings.trials,
            "seed": problem.settings.seed,
        }
    if experiment.fit == "learn":
        check_learnable(model, experiment)
        return lambda drive, train, _: learn_from(drive, train), {
            "free_parameters": n_learned(model, experiment)
        }
    specs = declared_parameters(model.rule, model.graph)
    numbers = sum(np.size(model.parameters[spec.name]) for spec in specs if spec.is_searched)
    return lambda *_: {}, {"free_parameters": 0 if experiment.tuned_on == "not_tuned" else numbers}


def _searcher(problem: Problem) -> Fit:
    """A search from scratch: the experiment's own values may have been tuned on the block."""

    def fit(drive: Drive, train: IntArray, block: int) -> Found:
        used = np.isin(np.arange(len(drive)), train)
        found = nested_search(replace(problem, drives=(drive,)), [used], block)
        return parameters_at(problem, found.point)[0]

    return fit


def _problem(drive: Drive) -> Problem:
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
    tuning = tuning.model_copy(update={"trials": tuning.trials or TRIALS})
    plan = Plan(experiment.name, "", (experiment,), tuning, experiment.source)
    return problem_of(plan, [drive])
