"""Fits: find parameters or tables from the training frames of some drives.

A fit is a function `fit(drives, train, fold) -> Fitted`: train has the training frames of each
drive, as indices into its annotated frames; fold is the number of the held-out fold, or None for
the final fit. The labels of all other frames are masked in `drives`.
"""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import optuna
import pandas as pd
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState

from egolane_pgm.drives import Drive
from egolane_pgm.experiment import FitSettings, Origin, TunedOn
from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.identity import content_of, digest_of, most_in_sample
from egolane_pgm.inference.compile import Compiled, counted_tables, with_tables
from egolane_pgm.inference.expected_counts import FREE
from egolane_pgm.inference.filtering import METHODS, filter_beliefs
from egolane_pgm.model import Model, make_evidence, with_parameters
from egolane_pgm.parameters import (
    Parameter,
    Value,
    check_names,
    not_searched,
    resolve_parameters,
)
from egolane_pgm.plugins import declared_parameters, plugin_errors
from egolane_pgm.scoring.bootstrap import LEVEL
from egolane_pgm.scoring.confusion import assigned_lane, log_loss_per_frame
from egolane_pgm.studies import em
from egolane_pgm.studies.gradient_fit import TablesOf, fit_numbers, fit_tables_to_known
from egolane_pgm.studies.objective import (
    PREFIX,
    beliefs_at,
    score_of,
    searched_of_detector,
    split,
    with_detector,
)
from egolane_pgm.studies.sampler import from_unit
from egolane_pgm.studies.search import (
    best_trial,
    new_study,
    quiet,
    sampler_name,
    search,
    settings_of,
)
from egolane_pgm.studies.space import (
    OPEN_END,
    Point,
    SearchSpace,
    coordinates,
    describe,
    make_space,
    to_parameters,
    to_point,
)
from egolane_pgm.studies.storage import open_storage, storage_errors
from egolane_pgm.tools.files import to_jsonable
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray


class Fitted(dict[str, Value]):
    """Parameters and tables by name; unchanged ones are omitted.

    - trials: a row per trial, see `trials_of`; None without a search.
    - posterior: of parameters that were fitted to labels, see `posterior_of`; None without any.
    """

    trials: pd.DataFrame | None = None
    posterior: pd.DataFrame | None = None


Fit = Callable[[Sequence[Drive], Sequence[IntArray], int | None], Fitted]

#: The default weight of the prior by the objective, rows of so many frames (log_loss: blocks).
STRENGTHS = {"log_loss": 10.0, "log_evidence": em.STRENGTH}

#: The largest number of starts: more were meant for a search.
MOST_STARTS = 100

#: The prefix of a learned table: `tables.Lane.next`; without a suffix if a node has one table.
TABLES = "tables."
_SLICES = (".first", ".next")


def fit_nothing(drives: Sequence[Drive], train: Sequence[IntArray], fold: int | None) -> Fitted:
    """Keep the experiment's parameters."""
    return Fitted()


def fit_by_name(
    method: str,
    *,
    storage: str | None = None,
    starts: Sequence[Mapping[str, Value]] = (),
    pooled: bool = False,
) -> Fit:
    """The fit of a method (`fit.method`): none, learn or tune; see `fit_tune` for the options."""
    tune = partial(fit_tune, storage=storage, starts=starts, pooled=pooled)
    fits: dict[str, Fit] = {"none": fit_nothing, "learn": fit_learn, "tune": tune}
    return fits[method]


def apply_fit(model: Model, fitted: Fitted) -> Model:
    """Put fitted parameters and tables into a model."""
    tables = {name: value for name, value in fitted.items() if name.startswith(TABLES)}
    own, detector = split({name: v for name, v in fitted.items() if name not in tables})
    if own:
        model = with_parameters(model, _resolve(model, {**model.parameters, **own}))
    if detector:
        model = replace(model, experiment=with_detector(model.experiment, detector))
    if tables:
        start = start_of_learning(model).compiled
        learned = {
            table.node: replace(table, values=np.reshape(tables[name], table.values.shape))
            for name, table in _by_name(start, counted_tables(start)).items()
            if name in tables
        }
        compiled = em.with_learned(start, learned)
        model = replace(model, compiled=compiled, learned_from="unknown")
    return model


def _resolve(model: Model, given: Mapping[str, Any]) -> dict[str, Value]:
    specs = declared_parameters(model.rule, model.graph)
    return resolve_parameters(specs, given, model.n_lanes, f"{model.experiment.source}: parameters")


# --- learn ---------------------------------------------------------------------------------------


def fit_learn(drives: Sequence[Drive], train: Sequence[IntArray], fold: int | None) -> Fitted:
    """Learn what `fit.learns` names: parameters of the evidence rule from labels, or the tables or
    parameters of the graph (`fit_graph`)."""
    if what_is_learned(drives[0].model) == "rule":
        return fit_rule(drives, train)
    return fit_graph(drives, train, fold)


def what_is_learned(model: Model) -> str:
    """The part of a model that is learned: rule, tables or parameters.

    By default it is the rule if it defines `fit` and `LEARNED`, and otherwise the tables. Raises
    InputError for a part that cannot be learned.
    """
    can_learn = model.rule.fit is not None
    e = model.experiment
    found = e.fit.learns or ("rule" if can_learn else "tables")
    if found == "rule" and not can_learn:
        raise InputError(f"{e.source}: fit.learns: evidence rule {e.evidence} has no fit()")
    if found == "tables":
        learnable_nodes(model)
    elif found == "parameters":
        tied_space([model])
    return found


def fit_rule(drives: Sequence[Drive], train: Sequence[IntArray]) -> Fitted:
    """Learn the parameters of an evidence rule from their defaults, by its function `fit`."""
    model, parts = drives[0].model, []
    rule = model.rule
    start = _resolve(model, {k: v for k, v in model.parameters.items() if k not in rule.learned})
    for drive, frames in zip(drives, train, strict=True):
        rows = drive.rows[frames]
        rows = rows[~drive.is_crossing[rows]]
        lane = np.zeros(len(drive.log), dtype=np.int64)
        lane[rows] = drive.true_lane[rows]
        parts.append((drive.log, lane, lane > 0))
    with plugin_errors(rule, "evidence"):
        found = rule.fit(parts, model.n_lanes, start) if rule.fit else {}
    if unknown := set(found).difference(rule.learned):
        raise InputError(f"{rule.file}: fit() returned {unknown.pop()}, not one of LEARNED")
    return Fitted(found)


def objective_of_learning(model: Model, *, of_lines: bool = False) -> str:
    """What tables or parameters of the graph are fitted to (`fit.objective`).

    By default it is the log-loss of the filter if labels are used, and otherwise, or if the lines
    are to be described (`of_lines`), the log evidence. Raises InputError for another score, and for
    the log-loss without labels.
    """
    options = model.experiment.fit
    where = f"{model.experiment.source}: fit.objective"
    default = "log_loss" if options.labels and not of_lines else "log_evidence"
    given = options.objective or (default,)
    if given == ("log_evidence",):
        return "log_evidence"
    if given != ("log_loss",):
        raise InputError(
            f"{where}: learning fits log_loss or log_evidence, not {', '.join(given)}; name one of"
            " them, or search with `egolane tune`"
        )
    if not options.labels:
        raise InputError(
            f"{where}: log_loss needs labels, and fit.labels is false; take log_evidence"
        )
    return "log_loss"


def strength_of_learning(
    model: Model, objective: str, nodes: Iterable[str]
) -> float | dict[str, float]:
    """The weight of the prior (`fit.strength`), with the default of the objective."""
    given = model.experiment.fit.strength
    default = STRENGTHS[objective]
    if isinstance(given, Mapping):
        return {**dict.fromkeys(nodes, default), **given}
    return default if given is None else float(given)


def fit_graph(
    drives: Sequence[Drive], train: Sequence[IntArray], fold: int | None = None
) -> Fitted:
    """Learn the tables or the parameters of the graph from all drives.

    They are fitted to the labels, which the filter predicts (`gradient_fit`), or to lines and
    labels together (tables by `em`); see `objective_of_learning`. The lane of a labelled frame is
    known, except while crossing. The best of `fit.trials` starts is kept: the declared values, then
    random ones.
    """
    model = drives[0].model
    options, source = model.experiment.fit, model.experiment.source
    n_lanes = sorted({drive.model.n_lanes for drive in drives})
    if len(n_lanes) > 1:
        raise InputError(
            f"{source}: n_lanes: learning needs drives with the same number of lanes; these have"
            f" {', '.join(map(str, n_lanes))}"
        )
    if (n_starts := options.trials or 1) > MOST_STARTS:
        raise InputError(f"{source}: fit.trials: learning takes at most {MOST_STARTS} starts")
    tuned_on = most_in_sample(drive.tuned_on() for drive in drives)
    if kept := kept_though_tuned(model, tuned_on):
        note = f"{', '.join(kept)} kept, so held-out scores may be in-sample"
        warnings.warn(f"{source}: tuned_on {tuned_on}: {note}", UserWarning, stacklevel=2)
    pairs = zip(drives, train, strict=True)
    data = joined([training_of(drive, frames, labels=options.labels) for drive, frames in pairs])
    if objective_of_learning(model) == "log_loss" and (data[1]["Lane"] == FREE).all():
        raise InputError(f"{source}: fit.objective: log_loss needs a labelled frame to learn from")
    fit_from = _tables_from if what_is_learned(model) == "tables" else _parameters_from
    fits = [fit_from(drives, data, k) for k in bar(range(n_starts), unit="start")]
    # The log posterior leaves impossible frames out.
    learned, found = max(
        fits, key=lambda each: (-each[0].is_impossible.sum(), each[0].log_posterior[-1])
    )
    impossible, graph = int(learned.is_impossible.sum()), f"graph {model.experiment.graph_name}"
    if impossible == len(learned.is_impossible):
        raise InputError(
            f"{source}: {graph} allows no frame of the {impossible} to learn from; do the evidence"
            " rule and the graph fit together?"
        )
    if impossible:
        note = f"{graph} does not allow {impossible} frame(s) to learn from; they are left out"
        warnings.warn(f"{source}: {note}", UserWarning, stacklevel=2)
    if fold is None and len(learned.draws):
        found.posterior = posterior_of(drives, data, learned)
    return found


def posterior_of(drives: Sequence[Drive], data: em.Data, learned: em.Learned) -> pd.DataFrame:
    """The posterior of the parameters of a graph that were fitted to labels (Laplace).

    Returns a row per parameter, and for `accuracy` and `log_loss` of the labelled frames that were
    fitted to: `name`, `value`, and the ends `low`, `high` of the 95 % interval.
    """
    space, tables_of = tied_tables(drives)
    evidence, known, is_first = data
    lane = known["Lane"]
    is_known = lane != FREE

    def scores(numbers: FloatArray) -> list[float]:
        compiled = with_tables(learned.compiled, tables_of(numbers))
        belief = filter_beliefs(compiled, evidence, is_first=is_first).lane[is_known]
        right = assigned_lane(belief) == lane[is_known] + 1
        return [right.mean(), log_loss_per_frame(belief, lane[is_known] + 1).mean()]

    of_draws = np.array([[*numbers, *scores(numbers)] for numbers in learned.draws])
    low, high = np.quantile(of_draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    names = [*space.distributions, "accuracy", "log_loss"]
    values = [*learned.numbers, *scores(learned.numbers)]
    return pd.DataFrame({"name": names, "value": values, "low": low, "high": high})


def joined(parts: Sequence[tuple[Evidence, IntArray, BoolArray]]) -> em.Data:
    """Join what `training_of` returns for several drives."""
    evidence, lanes, begins = zip(*parts, strict=True)
    return Evidence.concat(evidence), {"Lane": np.concatenate(lanes)}, np.concatenate(begins)


def _tables_from(drives: Sequence[Drive], data: em.Data, k: int) -> tuple[em.Learned, Fitted]:
    """Learn tables from start k; start 0 is the declared tables, around which the prior is."""
    model, options = drives[0].model, drives[0].experiment.fit
    compiled, nodes = start_of_learning(model).compiled, learnable_nodes(model)
    own = {node: t for node, t in counted_tables(compiled).items() if node[0] in nodes}
    start = em.drawn_tables(own, np.random.default_rng([options.seed, k])) if k else None
    objective = objective_of_learning(model)
    strength = strength_of_learning(model, objective, nodes)
    shared: Any = {"nodes": nodes, "strength": strength, "start": start}
    if objective == "log_loss":
        learned = fit_tables_to_known(compiled, data, block=options.block, **shared)
    else:
        learned = em.fit_tables(compiled, *data, **shared)
    tables = _by_name(compiled, learned.tables).items()
    return learned, Fitted({name: tuple(table.values.ravel().tolist()) for name, table in tables})


def _parameters_from(drives: Sequence[Drive], data: em.Data, k: int) -> tuple[em.Learned, Fitted]:
    """Learn parameters from start k; start 0 is the experiment's values.

    The prior of a fit to the labels is around these values; another one has a flat prior.
    """
    start = start_of_learning(drives[0].model)
    space, tables_of = tied_tables(drives)
    options = start.experiment.fit
    ends = list(space.distributions.values())
    own = list(coordinates(space, start.parameters).values())
    units = np.random.default_rng([options.seed, k]).random(len(ends)).tolist()
    drawn = [from_unit(d, unit) for d, unit in zip(ends, units, strict=True)]
    first = drawn if k else own
    bounds = [(d.low, d.high) for d in ends]
    prior: dict[str, Any] = {}
    if objective_of_learning(start) == "log_loss":
        prior = {"block": options.block, "centre": own}
        if not may_be_tuned(start.experiment.tuned_on):
            check_inside(space, own, f"{start.experiment.source}: parameters")
    scales = {s.name for s in start.graph.parameters if s.kind in ("sigma", "positive")}
    is_scale = [key.partition("[")[0] in scales for key in space.distributions]
    learned = fit_numbers(start.compiled, data, tables_of, first, bounds, is_scale, **prior)
    point = dict(zip(space.distributions, learned.numbers.tolist(), strict=True))
    return learned, Fitted(searched_values(space, options, point))


def tied_tables(drives: Sequence[Drive]) -> tuple[SearchSpace, TablesOf]:
    """The space of the parameters of the graph that are learned, and their tables by its
    coordinates."""
    start = start_of_learning(drives[0].model)
    space = tied_space([drive.model for drive in drives])

    def tables_of(numbers: FloatArray) -> Sequence[Table]:
        point = dict(zip(space.distributions, numbers.tolist(), strict=True))
        values = to_parameters(space, point)
        if start.graph.tables is not None:
            return start.graph.tables(start.n_lanes, values)
        return list(with_parameters(start, values).compiled.tables.values())

    return space, tables_of


def check_inside(space: SearchSpace, values: Sequence[float], where: str) -> None:
    """Raise InputError for a number outside of its range."""
    for (name, d), value in zip(space.distributions.items(), values, strict=True):
        # The ends of open ranges are allowed.
        margin = 2 * OPEN_END * (d.high - d.low)
        if not d.low - margin <= value <= d.high + margin:
            raise InputError(
                f"{where}.{name}: {value} is outside of [{d.low:g}, {d.high:g}] (fit.parameters);"
                " widen the range, or start inside it"
            )


def posterior_beside_profile(
    drives: Sequence[Drive], train: Sequence[IntArray]
) -> pd.DataFrame | None:
    """The posterior of the parameters of the graph by a fit to the labels, for a search.

    None for a graph without real parameters, and without labels.
    """
    own: dict[str, Any] = {
        "learns": "parameters",
        "objective": ("log_loss",),
        "parameters": {},
        "trials": None,
    }
    changed = []
    for drive in drives:
        e = drive.experiment
        fit = e.fit.model_copy(update=own)
        model = replace(drive.model, experiment=e.model_copy(update={"fit": fit}))
        changed.append(replace(drive, model=model))
    with contextlib.suppress(InputError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit_graph(changed, train).posterior
    return None


def tied_space(models: Sequence[Model]) -> SearchSpace:
    """The parameters of the graph that are learned: real numbers. Raises InputError for others."""
    e = models[0].experiment
    space = search_space(models, e.fit.model_copy(update={"objective": ("log_evidence",)}))
    for name, d in space.distributions.items():
        if not isinstance(d, FloatDistribution):
            raise InputError(
                f"{e.source}: fit.parameters.{name}: only real numbers are learned; give it one"
                " value"
            )
    return space


def training_of(
    drive: Drive, train: IntArray, *, labels: bool, evidence: Evidence | None = None
) -> tuple[Evidence, IntArray, BoolArray]:
    """The evidence of the training frames of a drive, their known lanes, and where sequences begin.

    A frame that is not annotated is used if its annotated neighbours on both sides are.
    """
    rows, n_frames = drive.rows, len(drive.log)
    is_train = np.zeros(len(rows), dtype=bool)
    is_train[train] = True
    before = np.searchsorted(rows, np.arange(n_frames), side="right") - 1
    after = np.searchsorted(rows, np.arange(n_frames), side="left")
    used = is_train[np.maximum(before, 0)] & is_train[np.minimum(after, len(rows) - 1)]
    lane = np.full(n_frames, FREE, dtype=np.int64)
    if labels:
        known = rows[train][~drive.is_crossing[rows[train]]]
        lane[known] = drive.true_lane[known] - 1
    # A rule may have a memory: its evidence is computed for the whole drive.
    if evidence is None:
        evidence, _ = make_evidence(drive.model, drive.log)
    is_first = np.diff(np.flatnonzero(used), prepend=-2) > 1
    return evidence.take(used), lane[used], is_first


def learnable_nodes(model: Model) -> set[str]:
    """The nodes whose tables are neither certain nor selected by an input.

    Raises InputError, naming the YAML key, if there are none, or if `fit.strength` names others.
    """
    source, strength = model.experiment.source, model.experiment.fit.strength
    names = {
        name
        for (name, _), table in counted_tables(start_of_learning(model).compiled).items()
        if not np.isin(table.values, (0.0, 1.0)).all()
    }
    if not names:
        raise InputError(
            f"{source}: all tables of graph {model.experiment.graph_name} are certain or selected"
            " by an input and cannot be learned; search parameters with `egolane tune`"
        )
    check_names(names, strength if isinstance(strength, Mapping) else (), f"{source}: fit.strength")
    return names


def start_of_learning(model: Model) -> Model:
    """The model with the tables that learning starts from.

    Parameters of the graph that may have been tuned on these frames start from their defaults.
    """
    values = dict(model.parameters)
    if may_be_tuned(model.experiment.tuned_on):
        own = model.graph.parameters
        values |= {spec.name: spec.default for spec in own if spec.is_searched}
    return with_parameters(model, _resolve(model, values))


def may_be_tuned(tuned_on: Origin) -> bool:
    """Whether parameters may have been tuned on the frames to learn from."""
    return tuned_on not in ("not_tuned", "other_drive", "other_frames")


def kept_though_tuned(model: Model, tuned_on: TunedOn) -> list[str]:
    """Parameters that learning keeps though they may have been tuned on the training frames."""
    e = model.experiment
    if not may_be_tuned(tuned_on):
        return []
    kept = [
        s.name
        for s in model.rule.parameters
        if s.is_searched and model.parameters[s.name] != s.default
    ]
    starts_anew = any(s.is_searched for s in model.graph.parameters)
    is_tuned_graph = tuned_on != "unknown" and not starts_anew
    return [*kept, *[f"graph {e.graph_name}"] * is_tuned_graph]


def _by_name(compiled: Compiled, tables: Mapping[SliceNode, Table]) -> dict[str, Table]:
    return {
        f"{TABLES}{name}{'' if name in compiled.one_table else _SLICES[s]}": table
        for (name, s), table in tables.items()
    }


# --- tune ----------------------------------------------------------------------------------------


def fit_tune(
    drives: Sequence[Drive],
    train: Sequence[IntArray],
    fold: int | None,
    *,
    storage: str | None = None,
    starts: Sequence[Mapping[str, Value]] = (),
    pooled: bool = False,
) -> Fitted:
    """Search the best parameters on the training frames, in an Optuna study.

    - storage: a URL as Optuna takes it, or a journal file; None for a study in memory. Each fold
      has its own study in it; an interrupted study is resumed.
    - starts: parameter sets that the study on everything tries first. The study of a fold starts
      from scratch: known values may have been tuned on the frames that are held out.
    - pooled: whether all frames count alike; otherwise all drives do.
    """
    tuning = drives[0].experiment.fit
    space = search_space([drive.model for drive in drives], tuning)
    settings = settings_of(tuning, fold, drives[0].experiment.source)
    used = [np.isin(np.arange(len(d)), t) for d, t in zip(drives, train, strict=True)]
    score = objective(drives, space, tuning, used, settings.scores, pooled=pooled)
    with storage_errors(storage):
        study = open_study(drives, train, fold, settings, space, storage)
        if fold is None:
            own = current_values(drives[0].model, tuning)
            with quiet():
                enqueue(study, [to_point(space, {**own, **each}) for each in starts])
        search(study, space, score, settings)
    fitted = Fitted(searched_values(space, tuning, best_trial(study).params))
    fitted.trials = trials_of(study)
    return fitted


def enqueue(study: optuna.Study, points: Sequence[Point | None]) -> None:
    """Let a study try points, unless it has tried them or will."""
    states = (TrialState.COMPLETE, TrialState.WAITING)
    for point in filter(None, points):
        trials = study.get_trials(deepcopy=False, states=states)
        tried = [trial.system_attrs.get("fixed_params", trial.params) for trial in trials]
        if dict(point) not in tried:
            study.enqueue_trial(dict(point))


def trials_of(study: optuna.Study) -> pd.DataFrame:
    """A row per trial: `number`, `state`, each score (in-sample) and each number searched."""
    rows = [
        {
            "number": trial.number,
            "state": trial.state.name,
            **dict(zip(study.metric_names or (), trial.values or (), strict=False)),
            **trial.params,
        }
        for trial in study.get_trials(deepcopy=False)
    ]
    return pd.DataFrame(rows)


def search_space(models: Sequence[Model], tuning: FitSettings) -> SearchSpace:
    """The search space of a model, or of several whose dimensions are the same.

    For the objective log_evidence, parameters of the evidence rule and of the detector keep their
    values: evidence is not normalised, so only models of the same evidence can be compared.

    Raises InputError for models with other parameters or lanes than the first one.
    """
    spaces, is_rule_kept = [], "log_evidence" in tuning.scores
    for model in models:
        specs: Sequence[Parameter] = declared_parameters(model.rule, model.graph)
        if searches_detector(tuning):
            specs = not_searched([*specs, *searched_of_detector(model.experiment)[0]])
        current, source = current_values(model, tuning), model.experiment.source
        where, own = f"{source}: fit.parameters", model.graph.parameters
        if is_rule_kept:
            specs = [s if s in own else replace(s, search=None) for s in specs]
        spaces.append(make_space(specs, current, tuning.parameters, model.n_lanes, where))
        moved = {key.partition("[")[0] for key in spaces[-1].distributions}
        if is_rule_kept and (others := moved - {spec.name for spec in own}):
            raise InputError(
                f"{where}.{min(others)}: changes the evidence, and log evidence compares models of"
                " the same evidence only; give it one value"
            )
        if spaces[-1].distributions != spaces[0].distributions:
            raise InputError(
                f"{source}: has other parameters or lanes than {models[0].experiment.source}; one"
                " set for both needs the same plugins, and a parameter with a value per lane cannot"
                " be shared between different roads"
            )
    return spaces[0]


def current_values(model: Model, tuning: FitSettings) -> dict[str, Value]:
    """The values of all parameters of a model, and of its detector if they are searched."""
    if not searches_detector(tuning):
        return dict(model.parameters)
    return {**model.parameters, **searched_of_detector(model.experiment)[1]}


def searches_detector(tuning: FitSettings) -> bool:
    """Whether parameters of the detector are searched; then all others are kept unless named."""
    return any(name.startswith(PREFIX) for name in tuning.parameters)


def searched_values(space: SearchSpace, tuning: FitSettings, point: Point) -> dict[str, Value]:
    """The parameters that are searched, or fixed by `fit.parameters`, at a point."""
    names = {*tuning.parameters, *(key.partition("[")[0] for key in space.distributions)}
    return {name: v for name, v in to_parameters(space, point).items() if name in names}


def objective(
    drives: Sequence[Drive],
    space: SearchSpace,
    tuning: FitSettings,
    used: Sequence[BoolArray],
    names: Sequence[str],
    *,
    pooled: bool = False,
) -> Callable[[Point], list[float]]:
    """The scores of a point of the search space; see `objective.score_of`.

    - used: per drive (K,), marks the annotated frames that are scored.

    Raises InputError for a filter that looks ahead.
    """
    for e in (drive.experiment for drive in drives):
        if e.filter not in METHODS:
            raise InputError(
                f"{e.source}: filter: a search takes assumed_density or exact, not {e.filter}"
            )
    beliefs = [beliefs_at(drive) for drive in drives]
    currents = [current_values(drive.model, tuning) for drive in drives]

    def values(point: Point) -> list[float]:
        changed = searched_values(space, tuning, point)
        pairs = zip(beliefs, currents, strict=True)
        found = [of_drive({**current, **changed}) for of_drive, current in pairs]
        return [score_of(drives, found, used, name, pooled=pooled) for name in names]

    return values


def open_study(
    drives: Sequence[Drive],
    train: Sequence[IntArray],
    fold: int | None,
    settings: FitSettings,
    space: SearchSpace,
    storage: str | None,
) -> optuna.Study:
    """Open or create the study of a fold. Raises InputError if the storage has another one."""
    if storage is None:
        return new_study(settings)
    name = drives[0].experiment.name + ("" if fold is None else f" without fold {fold + 1}")
    cure = "the storage is damaged; name another directory or storage"
    try:
        study = new_study(settings, storage=open_storage(storage), study_name=name)
    except json.JSONDecodeError as error:
        # Optuna finds a damaged last line when another one follows it.
        raise InputError(f"study {name}: {error}: {cure}") from error
    content = {
        "objective": settings.scores,
        "sampler": sampler_name(settings.sampler),
        "seed": settings.seed,
        "space": describe(space),
        "experiment": [digest_of(content_of(drive.experiment, _IN_SPACE)) for drive in drives],
        "data": drives_digest(drives, train, _IN_SPACE),
    }
    known = json.loads(json.dumps(to_jsonable(content)))
    before = study.user_attrs.get("identity", known)
    if not isinstance(before, dict) or before.keys() != known.keys():
        raise InputError(
            f"study {name}: was written by another version, or is damaged; name another directory"
            " or storage"
        )
    if before != known:
        what = ", ".join(key for key in known if before[key] != known[key])
        raise InputError(
            f"study {name}: the storage holds another study of this name, with another {what};"
            " name another directory or storage"
        )
    keys = set(space.distributions)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
        if missing := keys - trial.params.keys():
            raise InputError(f"study {name}: trial {trial.number} has no {min(missing)}: {cure}")
        is_whole = len(trial.values or ()) == len(settings.scores)
        if not is_whole or bool in map(type, trial.params.values()):
            raise InputError(f"study {name}: trial {trial.number} has other values: {cure}")
    study.set_user_attr("identity", known)
    return study


#: Keys of an experiment that the space, or the settings of a search, contain.
_IN_SPACE = ("parameters", "fit", "tuned_on")


def drives_digest(
    drives: Sequence[Drive], train: Sequence[IntArray], harmless: Sequence[str] = ()
) -> str:
    """A checksum of drives, of their experiments and of their training frames.

    - harmless: keys of the experiments that are left out.
    """
    parts = [
        {
            "experiment": content_of(drive.experiment, harmless),
            "lines": replace(drive.log, source=""),
            "labels": [drive.true_lane, drive.is_crossing],
            "frames": frames,
        }
        for drive, frames in zip(drives, train, strict=True)
    ]
    return digest_of(parts)
