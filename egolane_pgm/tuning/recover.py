"""The search for the parameters behind the paper's published matrices: an Optuna study per run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import FrozenTrial, Trial

from egolane_pgm.drive import belief_of, load_drive
from egolane_pgm.experiment import load_experiment
from egolane_pgm.paper import load_published, paper_experiment, published_path
from egolane_pgm.report.study_trials import quiet
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion, frames_off
from egolane_pgm.tools.files import read_text, write_text
from egolane_pgm.tuning.sampler import Shade

#: The published parameters are truncated to three decimals: the value used was below this higher.
TRUNCATION = 0.001

#: Progress is told after so many trials.
_REPORTED = 100


@dataclass(frozen=True)
class Recovered:
    """What `recover` found.

    - parameters: the best set.
    - frames_off: frames that its confusion matrix is off the published one.
    - evaluations: number of sets that were tried.
    """

    parameters: Mapping[str, float]
    frames_off: int
    evaluations: int


def recover(
    number: int,
    *,
    evaluations: int = 20_000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Recovered:
    """Search the box [v, v + 0.001) of each published parameter for the published matrix.

    - number: of the paper's run, 1 to 10.
    - evaluations: the study stops after so many trials, or when no frame is off any more.
    - seed: of the sampler, `Shade`; the values as printed are tried first.
    - progress: called now and then with the trials since, and the fewest frames off.
    """
    entry = load_published()[number]
    printed = {k: v for k, v in entry["parameters"].items() if k != "bonus_value"}
    drive = load_drive(
        load_experiment(paper_experiment(number)), needs_truth="the published matrix counts with it"
    )
    target, truth = np.asarray(entry["model"]["confusion"]), drive.truth

    def objective(trial: Trial) -> int:
        values = {k: trial.suggest_float(k, d.low, d.high) for k, d in box.items()}
        assigned = assigned_lane(belief_of(drive, {**drive.model.parameters, **values}))
        matrix = confusion(assigned, truth.lane, truth.is_crossing, drive.n_lanes)
        return frames_off(matrix, target)

    def after(study: optuna.Study, trial: FrozenTrial) -> None:
        if trial.value == 0:
            study.stop()
        if progress is not None and (trial.number + 1) % _REPORTED == 0:
            progress(_REPORTED, int(study.best_value))

    box = {k: FloatDistribution(v, math.nextafter(v + TRUNCATION, v)) for k, v in printed.items()}
    space: dict[str, BaseDistribution] = dict(box)
    with quiet():
        study = optuna.create_study(sampler=Shade(seed, space))
        study.set_metric_names(["frames_off"])
        study.enqueue_trial(printed)
        study.optimize(objective, n_trials=evaluations, callbacks=[after])
    parameters = {**study.best_params, "bonus_value": entry["parameters"]["bonus_value"]}
    return Recovered(parameters, int(study.best_value), len(study.trials))


def store_recovered(number: int, found: Recovered, how: str, path: Path | None = None) -> None:
    """Put what was found under `recovered` of the run in published.yaml, and nothing else."""
    path = path or published_path()
    lines = read_text(path).splitlines()
    start = next(i for i, text in enumerate(lines) if text.strip() == f"- run: {number}")
    end = next(
        (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("- run:")),
        len(lines),
    )
    block = _without_recovered(lines[start:end])
    block += [
        "    recovered:",
        f"      parameters: {{{', '.join(f'{k}: {v!r}' for k, v in found.parameters.items())}}}",
        f"      frames_off: {found.frames_off}",
        f"      evaluations: {found.evaluations}",
        f"      how: {how}",
    ]
    text = "\n".join([*lines[:start], *block, *lines[end:]]) + "\n"
    write_text(path, text)


def _without_recovered(block: Sequence[str]) -> list[str]:
    if "    recovered:" not in block:
        return list(block)
    return list(block[: list(block).index("    recovered:")])
