"""`fit: choose`: constants from a grid, chosen without the frames that are scored.

A candidate is one value for each parameter of the grid. For block b of a recording every candidate
is tried on all recordings that the experiment's `choice` names, the own one included:

- on each stretch of road c with what is learned without c;
- on the drive that b belongs to, also without b. The stretch of road of b is left out in every
  recording of that drive.

With `choice.objective: accuracy` the loss of a frame is 1 where the assigned lane is not the true
one (Unassigned included, by `unassigned_below` too), else 0. With `log_loss` it is -ln P(true
lane), but at most -ln FLOOR: beyond that it says how sure a wrong belief was, not how often the
belief is wrong.

The candidate with the least mean loss is chosen. With `choice.cautious` an earlier value of that
parameter is kept where its best candidate is worse by no more than one standard error: of the least
mean loss (Breiman et al. 1984, the 1 SE rule) or of the paired difference (`choice.error_of`). The
error is taken over the stretches of road, because recordings of one stretch share its luck. The
best of many candidates looks better than it is, which the error of a difference does not know.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from egolane_pgm.comparing.placing import (
    load_for_scoring,
    on_recordings,
    on_stretch,
    recording_key,
    stretch,
)
from egolane_pgm.drive import Drive, beliefs_of, drive_key
from egolane_pgm.experiment import Experiment
from egolane_pgm.learning import Found, with_found
from egolane_pgm.learning import fit as learn_from
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.types import FloatArray, InputError, IntArray

#: P(true lane) counts as this where it is less.
FLOOR = 0.01


def _is_wrong(belief: FloatArray, lane: IntArray, unassigned_below: float) -> FloatArray:
    return np.asarray(assigned_lane(belief, unassigned_below) != lane, dtype=np.float64)


def _capped_log_loss(belief: FloatArray, lane: IntArray, _: float) -> FloatArray:
    return np.asarray(-np.log(np.maximum(belief[np.arange(len(lane)), lane - 1], FLOOR)))


#: The loss of each frame (K,) of a belief (K, n), the true lanes (K,) and `unassigned_below`, by
#: objective.
LOSSES: Mapping[str, Callable[[FloatArray, IntArray, float], FloatArray]] = {
    "accuracy": _is_wrong,
    "log_loss": _capped_log_loss,
}

Candidate = Mapping[str, Any]


@dataclass(frozen=True)
class Task:
    """A recording on which the candidates are tried.

    experiment: the model on this recording.
    stretches: the first and last frame id of each block, over all recordings of the drive.
    is_target: whether blocks of this drive are scored.
    is_alone: whether blocks of no other drive are scored.
    """

    experiment: Experiment
    stretches: tuple[tuple[int, int], ...]
    is_target: bool
    is_alone: bool

    @property
    def key(self) -> str:
        """The same for tasks with the same result."""
        unused: dict[str, Any] = {"name": True, "description": True}
        unused["choice"] = {"objective", "cautious", "error_of"}
        content = self.experiment.model_dump(exclude=unused)
        folder = str(self.experiment.folder.absolute())
        return repr((content, folder, self.stretches, self.is_target, self.is_alone))


@dataclass(frozen=True)
class Losses:
    """The losses of S candidates on one recording, with B blocks.

    drive: which drive the recording is of (`drive.drive_key`).
    sums (S, B, B), by objective: [s, b, c] is the loss of candidate s, summed over the frames of
        stretch c that are not in b, with what was learned without both (b = c: without c).
    frames (B, B): the number of these frames.
    """

    drive: str
    sums: Mapping[str, FloatArray]
    frames: IntArray


#: The losses on each recording of an experiment's choice, by `experiment_key`.
Known = Mapping[str, Sequence[Losses]]


def experiment_key(experiment: Experiment) -> str:
    """Which experiment on which recording."""
    return repr((experiment.source, experiment.name, recording_key(experiment)))


def candidates(experiment: Experiment) -> list[dict[str, Any]]:
    """Every candidate of the grid; the last parameter changes fastest. Raises InputError without a
    grid."""
    if experiment.choice is None:
        raise InputError(f"{experiment.source}: fit: choose needs choice.grid, what to choose from")
    grid = experiment.choice.grid
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


def plan(
    experiments: Iterable[Experiment], n_blocks: int, *, is_held_out: bool = True
) -> dict[str, list[Task]]:
    """List the recordings on which candidates are tried, for each of the experiments that say
    `fit: choose`, by `experiment_key`. Tasks of the same `key` need to be done only once.

    is_held_out: False for one choice with the help of every block.

    Reads the recordings. Raises InputError as that does, and for a grid that does not go with the
    experiment.
    """
    chosen = [e for e in experiments if e.fit == "choose"]
    drives: dict[str, Drive] = {}
    pools: list[list[Experiment]] = []
    for own in chosen:
        _check_grid(own)
        assert own.choice is not None
        pool = {recording_key(own): own}
        for other in on_recordings(own, own.choice.recordings, "choice.recordings"):
            pool.setdefault(recording_key(other), other)
        pools.append(list(pool.values()))
        for key, experiment in pool.items():
            if key not in drives:
                drives[key] = load_for_scoring(experiment)
    targets = {drive_key(own) for own in chosen if is_held_out}
    tasks = {}
    for own, members in zip(chosen, pools, strict=True):
        ends: dict[str, list[tuple[int, int]]] = {}
        for experiment in members:
            drive = drives[recording_key(experiment)]
            mine = [stretch(drive, part) for part in blocks(len(drive), n_blocks)]
            known = ends.setdefault(drive_key(experiment), mine)
            ends[drive_key(experiment)] = [
                (min(a, c), max(b, d)) for (a, b), (c, d) in zip(known, mine, strict=True)
            ]
        tasks[experiment_key(own)] = [
            Task(
                experiment,
                tuple(ends[drive_key(experiment)]),
                drive_key(experiment) in targets,
                targets == {drive_key(experiment)},
            )
            for experiment in members
        ]
    return tasks


def _check_grid(experiment: Experiment) -> None:
    found = candidates(experiment)
    model = prepare_model(experiment)
    specs = declared_parameters(model.rule, model.graph)
    for candidate in found:
        resolve_parameters(specs, candidate, model.n_lanes, f"{experiment.source}: choice.grid")


def try_all(tasks: Sequence[Task], jobs: Jobs = 1) -> Iterator[Losses]:
    """The losses of each task, in order. jobs: the number of processes that share them."""
    return in_order(losses_of, tasks, jobs)


def losses_by_experiment(
    tasks: Mapping[str, Sequence[Task]],
    jobs: Jobs = 1,
    show: Callable[[Iterator[Losses], int], Iterable[Losses]] = lambda found, total: found,
) -> Known:
    """The losses of the tasks that were planned, each distinct one done once.

    show: is given the losses as they come and how many there will be, for a progress bar.
    """
    todo = {task.key: task for mine in tasks.values() for task in mine}
    found = show(try_all(list(todo.values()), jobs), len(todo))
    done = dict(zip(todo, found, strict=True))
    return {key: [done[task.key] for task in mine] for key, mine in tasks.items()}


def losses_of(task: Task) -> Losses:
    """The losses of every candidate on one recording."""
    drive = load_for_scoring(task.experiment)
    truth, n_stretches = drive.truth, len(task.stretches)
    inside = [on_stretch(drive, ends) for ends in task.stretches]
    trusted = drive.may_fit
    tried = _Tried(drive, candidates(task.experiment))
    shape = (len(tried.models), n_stretches, n_stretches)
    sums = {objective: np.zeros(shape) for objective in LOSSES}
    frames = np.zeros((n_stretches, n_stretches), dtype=np.int64)
    for b, c in itertools.combinations_with_replacement(range(n_stretches), 2):
        # On the drive that is scored one stretch is left out for that, another to try it on.
        is_needed = not task.is_alone if b == c else task.is_target
        train = np.flatnonzero(trusted & ~inside[b] & ~inside[c])
        if not is_needed:
            continue
        if not len(train):
            raise InputError(
                f"{task.experiment.source}: blocks {b + 1} and {c + 1}: no frame is left to learn"
                " from; take more blocks, or exclude fewer frames"
            )
        loss = tried.losses(train)
        for without, on in {(b, c), (c, b)}:
            is_scored = trusted & ~truth.is_crossing & inside[on]
            if without != on:
                is_scored &= ~inside[without]
            for objective, values in loss.items():
                sums[objective][:, without, on] = values[:, is_scored].sum(axis=1)
            frames[without, on] = np.count_nonzero(is_scored)
    return Losses(drive_key(task.experiment), sums, frames)


class _Tried:
    """The candidates on one drive.

    The losses of each candidate are kept together with what it had learned for them, because often
    the same is learned next: always, where nothing is learned.
    """

    def __init__(self, drive: Drive, tried: Sequence[Candidate]) -> None:
        self.drive = drive
        experiment = drive.experiment
        self.models = [with_found(drive.model, each, experiment) for each in tried]
        self.last: dict[int, tuple[str, list[FloatArray]]] = {}

    def losses(self, train: IntArray) -> dict[str, FloatArray]:
        """By objective the loss (S, K) of each candidate in each annotated frame, with what is
        learned from the frames `train`."""
        experiment = self.drive.experiment
        known: dict[str, Found] = {}
        losses: list[list[FloatArray]] = []
        for s, model in enumerate(self.models):
            found: Found = {}
            if learns(model, experiment):
                ignored = getattr(model.rule, "FIT_IGNORES", ())
                key = repr({k: v for k, v in model.parameters.items() if k not in ignored})
                if key not in known:
                    known[key] = self._learned(model, train)
                found = known[key]
            what = repr(found)
            if s not in self.last or self.last[s][0] != what:
                self.last[s] = what, self._losses(with_found(model, found, experiment))
            losses.append(self.last[s][1])
        return {name: np.stack([each[k] for each in losses]) for k, name in enumerate(LOSSES)}

    def _learned(self, model: Model, train: IntArray) -> Found:
        # The warning of a lane without a frame comes again where the chosen candidate learns.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            seen = self.drive.only_labels_of(train)
            return learn_from(replace(seen, model=model), train)

    def _losses(self, model: Model) -> list[FloatArray]:
        drive = self.drive
        belief = beliefs_of(drive, model)[0].lane
        below = drive.experiment.unassigned_below
        return [of(belief, drive.truth.lane, below) for of in LOSSES.values()]


def learns(model: Model, experiment: Experiment) -> bool:
    """Whether something is learned besides what is chosen: the parameters of an evidence rule that
    can learn, or, where the experiment has a section `learning`, the tables of the graph."""
    return hasattr(model.rule, "fit") or experiment.learning is not None


def choose(losses: Sequence[Losses], own_drive: str, block: int, experiment: Experiment) -> int:
    """The number of the candidate that is chosen for a block.

    losses: on each recording of the choice.
    own_drive: the drive of the recording that is scored ("" where no block is left out).
    block: the one that is scored, from 0.
    """
    choice = experiment.choice
    assert choice is not None
    sums, n_frames = _clusters(losses, choice.objective, own_drive, block)
    total = sums.sum(axis=0)
    best = int(total.argmin())
    if choice.cautious is None or len(sums) < 2:
        return best
    sizes = [len(values) for values in choice.grid.values()]
    level = np.unravel_index(np.arange(len(total)), sizes)[list(choice.grid).index(choice.cautious)]
    for value in range(int(level[best])):
        rival = int(np.where(level == value, total, np.inf).argmin())
        worse = (sums[:, rival] - sums[:, best]) / n_frames
        of = worse if choice.error_of == "difference" else sums[:, best] / n_frames
        if float(worse.sum()) <= math.sqrt(len(of)) * float(of.std(ddof=1)):
            return rival
    return best


def chosen_on_all(experiment: Experiment, losses: Sequence[Losses]) -> Experiment:
    """The experiment with the constants that are best on all blocks of all recordings, ready to
    learn. losses: of tasks that were planned with is_held_out False."""
    chosen = candidates(experiment)[choose(losses, "", 0, experiment)]
    changes = {"fit": "learn", "parameters": {**experiment.parameters, **chosen}}
    return experiment.model_copy(update=changes)


def _clusters(
    losses: Sequence[Losses], objective: str, own_drive: str, block: int
) -> tuple[FloatArray, int]:
    """The losses (C, S) on each of the C stretches of road that may be looked at, summed over the
    recordings of the stretch; and the number of frames."""
    sums: dict[tuple[str, int], FloatArray] = {}
    n_frames = 0
    for one in losses:
        for c in range(one.frames.shape[0]):
            is_own = one.drive == own_drive
            if is_own and c == block:
                continue
            without = block if is_own else c
            key = (one.drive, c)
            sums[key] = sums.get(key, 0.0) + one.sums[objective][:, without, c]
            n_frames += int(one.frames[without, c])
    if not n_frames:
        raise InputError(f"block {block + 1}: no frame is left to choose on")
    return np.stack(list(sums.values())), n_frames
