"""The trials of a study as Optuna has them, and what its figures show of them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.exceptions import ExperimentalWarning
from optuna.trial import create_trial
from pydantic_core import from_json

from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.tools.files import read_parquet
from egolane_pgm.types import FloatArray, InputError

STUDY_FILE, TRIALS_FILE, SCHEMA_VERSION = "study.json", "trials.parquet", 1

#: Importances of fewer trials than this would be noise.
FEWEST = 20


@dataclass(frozen=True)
class Trials:
    """The finished trials of a study.

    - document: its study.json.
    - study: the trials in the order of their numbers, each with its in-sample score of the first
      objective.
    """

    document: Mapping[str, Any]
    study: optuna.Study

    @property
    def name(self) -> str:
        """The study's name."""
        return str(self.document["name"])

    @property
    def objective(self) -> str:
        """The score that is shown."""
        return str(self.document["tuning"]["objective"][0])

    @property
    def space(self) -> dict[str, BaseDistribution]:
        """What each parameter was searched on."""
        return self.study.trials[0].distributions

    @property
    def gain(self) -> FloatArray:
        """(N,): the score, negative where less is better."""
        sign = 1 if is_maximised(self.objective) else -1
        return sign * np.array([trial.value for trial in self.study.trials])

    @property
    def held_out(self) -> Mapping[str, Any]:
        """What study.json says of the frames that were not searched on; empty where none were."""
        return self.document.get("held_out") or {}


def is_study(directory: str | Path) -> bool:
    """Whether the directory holds a finished study."""
    return (Path(directory) / STUDY_FILE).is_file()


def read_trials(directory: str | Path) -> Trials:
    """Read study.json and trials.parquet of a study; no recording is needed.

    Raises InputError for a directory without a study, damaged files, and a study without a finished
    trial.
    """
    return trials_of(*read_study_files(Path(directory)), str(directory))


def read_study_files(directory: Path) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """The content of study.json, and the columns of trials.parquet. Raises InputError, naming the
    file, for one that is missing, damaged or of another schema version."""
    path = directory / STUDY_FILE
    try:
        content = from_json(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(
            f"{directory}: is not the directory of a finished study ({STUDY_FILE} is missing or"
            " damaged); make one with `egolane tune`"
        ) from error
    if not isinstance(content, dict) or content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{path}: is not of schema version {SCHEMA_VERSION}; tune again")
    try:
        return content, read_parquet(directory / TRIALS_FILE).to_pydict()
    except InputError as error:
        raise InputError(f"{error}; repeat the `egolane tune` command") from None


def trials_of(
    content: Mapping[str, Any], table: Mapping[str, Sequence[Any]], directory: str
) -> Trials:
    """The trials of a study.

    - content: its study.json. table: the columns of its trials.parquet.
    - directory: for messages.

    Raises InputError where these do not belong together, and for a study without a finished trial.
    """
    try:
        study = _study(content, table)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{directory}: {STUDY_FILE} or {TRIALS_FILE} is damaged ({error!r}); tune again"
        ) from error
    if not study.trials:
        raise InputError(
            f"{directory}: no trial of this study is finished, there is nothing to draw"
        )
    return Trials(content, study)


def _study(content: Mapping[str, Any], table: Mapping[str, Sequence[Any]]) -> optuna.Study:
    """The finished trials as a study in memory."""
    objective = str(content["tuning"]["objective"][0])
    scores = table[f"{objective}_in_sample"]
    bounds = content["space"]["searched"]
    space = {key: _distribution(bounds[key], table[key]) for key in bounds}
    with quiet():
        study = optuna.create_study(direction="maximize" if is_maximised(objective) else "minimize")
    for k in np.argsort(table["number"], kind="stable"):
        if scores[k] is not None and np.isfinite(scores[k]):
            point = {key: table[key][k] for key in space}
            study.add_trial(create_trial(params=point, distributions=space, value=scores[k]))
    return study


def _distribution(bounds: Sequence[Any], column: Sequence[Any]) -> BaseDistribution:
    if isinstance(bounds[0], str):
        return CategoricalDistribution(bounds)
    if all(v is None or isinstance(v, int) for v in column):
        return IntDistribution(int(bounds[0]), int(bounds[1]))
    return FloatDistribution(*bounds)


def importances(trials: Trials) -> dict[str, float]:
    """Per parameter, how much of what sets the best tenth of the trials apart from the rest it
    explains (PED-ANOVA, as Optuna has it); they add up to 1, most important first.

    Empty where fewer than 20 trials are finished, or all have one score.
    """
    if len(trials.study.trials) < FEWEST or np.ptp(trials.gain) == 0:
        return {}
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    return optuna.importance.get_param_importances(trials.study, evaluator=evaluator)


@contextmanager
def quiet() -> Iterator[None]:
    """Optuna without a line per study, and without notes on what it calls experimental."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)
