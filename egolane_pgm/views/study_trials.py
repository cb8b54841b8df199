"""The trials of a study as arrays, and what its figures show of them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna import distributions
from optuna.exceptions import ExperimentalWarning
from optuna.trial import create_trial
from pydantic_core import from_json

from egolane_pgm.scoring.confusion import is_maximised
from egolane_pgm.tools.files import read_parquet
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray

STUDY_FILE, TRIALS_FILE, SCHEMA_VERSION = "study.json", "trials.parquet", 1

#: As good as the best: 0.5 points of accuracy, and as much of any other score.
TOLERANCE = 0.005

#: Importances of fewer trials than this would be noise.
FEWEST = 20


@dataclass(frozen=True)
class Searched:
    """A parameter that was searched, from `low` to `high`, both included. Choices are counted from
    0, in the order of `choices`."""

    key: str
    low: float
    high: float
    is_integer: bool = False
    choices: tuple[str, ...] = ()

    def share(self, values: FloatArray) -> FloatArray:
        """Where values lie on the range: 0 at the lower, 1 at the upper end; whole numbers and
        choices at the middle of their cell."""
        if self.is_integer:
            return np.asarray((values - self.low + 0.5) / (self.high - self.low + 1))
        return np.asarray((values - self.low) / (self.high - self.low))

    def value(self, number: float) -> float | int | str:
        """The parameter's own value."""
        if self.choices:
            return self.choices[round(number)]
        return round(number) if self.is_integer else float(number)

    def label(self, value: float) -> str:
        """A value for people."""
        if self.choices:
            return self.choices[round(value)]
        if self.is_integer:
            return f"{value:.0f}"
        # An open range, (0, 3], begins a hair inside: for people it begins at 0.
        return "0" if abs(value) <= 1e-5 * (self.high - self.low) else f"{value:.3g}"


@dataclass(frozen=True)
class Trials:
    """The finished trials of a study, in the order of their numbers.

    number (N,); score (N,), in-sample, of the first objective; values: per key of `searched` (N,);
    best: index of the best trial, the first among equals; held_out: the score on frames that were
    not searched on, NaN where there is none; reference: known values, of the paper where
    `reference_name` says so; nested: the best point of each study without a part of the frames.
    """

    name: str
    objective: str
    searched: tuple[Searched, ...]
    number: IntArray
    score: FloatArray
    values: Mapping[str, FloatArray]
    best: int
    held_out: float
    reference: Mapping[str, float]
    reference_name: str
    nested: tuple[Mapping[str, float], ...]

    @property
    def is_maximised(self) -> bool:
        """Whether a larger score is better."""
        return is_maximised(self.objective)

    @property
    def gain(self) -> FloatArray:
        """(N,): the score, negative where less is better."""
        return self.score if self.is_maximised else -self.score


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
        return _trials(content, table)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise InputError(f"{directory}: {error}") from None
        raise InputError(
            f"{directory}: {STUDY_FILE} or {TRIALS_FILE} is damaged ({error!r}); tune again"
        ) from error


def _trials(content: Mapping[str, Any], table: Mapping[str, Sequence[Any]]) -> Trials:
    objective = str(content["tuning"]["objective"][0])
    number = _floats(table["number"])
    order = np.argsort(number, kind="stable")
    score = _floats(table[f"{objective}_in_sample"])[order]
    chosen = order[np.isfinite(score)]
    score = score[np.isfinite(score)]
    if not len(score):
        raise InputError("no trial of this study is finished, there is nothing to draw")
    bounds = content["space"]["searched"]
    searched = tuple(_searched(key, bounds[key], table[key]) for key in bounds)
    held_out = content.get("held_out") or {}
    reference, named = _reference(content, searched)
    return Trials(
        str(content["name"]),
        objective,
        searched,
        number[chosen].astype(np.int64),
        score,
        {s.key: _numbers(s, table[s.key])[chosen] for s in searched},
        int(np.argmax(score if is_maximised(objective) else -score)),
        float((held_out.get("all_frames") or {}).get(objective, np.nan)),
        reference,
        named,
        tuple(_point(searched, s["point"]) for s in held_out.get("studies", ())),
    )


def _floats(column: Sequence[Any]) -> FloatArray:
    """A column of numbers, NaN for those that a trial lacks."""
    return np.array(column, dtype=np.float64)


def _searched(key: str, bounds: Sequence[Any], column: Sequence[Any]) -> Searched:
    if isinstance(bounds[0], str):
        return Searched(key, 0, len(bounds) - 1, True, tuple(bounds))
    is_integer = all(v is None or isinstance(v, int) for v in column)
    return Searched(key, float(bounds[0]), float(bounds[1]), is_integer)


def _numbers(searched: Searched, column: Sequence[Any]) -> FloatArray:
    if not searched.choices:
        return _floats(column)
    return np.array([np.nan if v is None else searched.choices.index(v) for v in column])


def _point(searched: Sequence[Searched], point: Mapping[str, Any]) -> dict[str, float]:
    found = {}
    for s in searched:
        value = point.get(s.key)
        if s.choices and value in s.choices:
            found[s.key] = float(s.choices.index(value))
        elif isinstance(value, (int, float)):
            found[s.key] = float(value)
    return found


def _reference(
    content: Mapping[str, Any], searched: Sequence[Searched]
) -> tuple[dict[str, float], str]:
    """The paper's values for one of its runs; else what all the experiments came with."""
    from egolane_pgm.paper import load_published, parameters_for

    if content.get("run") is not None:
        return _point(searched, parameters_for(load_published()[content["run"]], "published")), (
            "the paper's"
        )
    points = [
        _point(searched, _per_lane(e["parameters"])) for e in content.get("experiments", ())
    ] or [{}]
    common = {k: v for k, v in points[0].items() if all(p.get(k) == v for p in points)}
    return common, "before the search"


def _per_lane(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters with one value per lane also under the keys of the search, `p3[2]`."""
    found = dict(parameters)
    for name, value in parameters.items():
        if isinstance(value, list):
            found |= {f"{name}[{lane}]": v for lane, v in enumerate(value, start=1)}
    return found


def as_good(trials: Trials, tolerance: float = TOLERANCE) -> BoolArray:
    """(N,): the trials whose score is within the tolerance of the best."""
    # Scores are ratios of counts: the bound itself counts in, whatever its last bit says.
    return np.asarray(trials.gain >= trials.gain.max() - tolerance - 1e-12)


@dataclass(frozen=True)
class Flat:
    """Values of one parameter among the trials that are as good as the best: from low to high, and
    the share of the search range that this is (whole numbers and choices: of its cells)."""

    low: float
    high: float
    share: float


def flat_ranges(trials: Trials, tolerance: float = TOLERANCE) -> dict[str, Flat]:
    """Per parameter, the range that the good trials span. It is what the search has seen: the real
    range can only be wider."""
    good = as_good(trials, tolerance)
    found = {}
    for s in trials.searched:
        values = trials.values[s.key][good]
        low, high = float(values.min()), float(values.max())
        if s.choices:
            share = len(np.unique(values)) / len(s.choices)
        else:
            share = (high - low + s.is_integer) / (s.high - s.low + s.is_integer)
        found[s.key] = Flat(low, high, share)
    return found


def study_of(trials: Trials) -> optuna.Study:
    """The trials as a study in memory, for Optuna's figures and importances."""
    ranges: dict[str, distributions.BaseDistribution] = {}
    for s in trials.searched:
        if s.choices:
            ranges[s.key] = distributions.CategoricalDistribution(s.choices)
        elif s.is_integer:
            ranges[s.key] = distributions.IntDistribution(int(s.low), int(s.high))
        else:
            ranges[s.key] = distributions.FloatDistribution(s.low, s.high)
    with quiet():
        study = optuna.create_study(direction="maximize" if trials.is_maximised else "minimize")
    study.add_trials(
        create_trial(
            params={s.key: s.value(trials.values[s.key][k]) for s in trials.searched},
            distributions=ranges,
            value=float(score),
        )
        for k, score in enumerate(trials.score)
    )
    return study


def importances(trials: Trials) -> dict[str, float]:
    """Per parameter, how much of what sets the best tenth of the trials apart from the rest it
    explains (PED-ANOVA, as Optuna has it); they add up to 1, most important first.

    Empty where fewer than 20 trials are finished, or all have one score.
    """
    if len(trials.score) < FEWEST or np.ptp(trials.score) == 0:
        return {}
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    return optuna.importance.get_param_importances(study_of(trials), evaluator=evaluator)


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
