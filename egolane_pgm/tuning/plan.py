"""What is to be tuned: an experiment, or a tuning file that names one or several.

    name: italy_all
    description: one parameter set for all detectors in Italy
    experiments: [../paper/run01_italy_ml.yaml, ../paper/run02_italy_sl.yaml]
    tuning: {trials: 3000, parameters: {p1: 0.9}}

With several experiments one parameter set is searched for all of them, each with equal weight.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import Field

from egolane_pgm.drive import Drive, load_drive
from egolane_pgm.experiment import (
    Experiment,
    Overrides,
    Section,
    Tuning,
    experiment_path,
    load_experiment,
    load_yaml,
    make_experiment,
    validated,
)
from egolane_pgm.model import Model
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.tuning.objective import (
    check_filter,
    check_objective,
    scores_of,
    searched_of_detector,
)
from egolane_pgm.tuning.search import TRIALS, Score, Settings, check_sampler
from egolane_pgm.tuning.space import Point, SearchSpace, make_space, to_parameters, to_point
from egolane_pgm.types import NOTE, BoolArray, InputError, problems_in


class TuningFile(Section):
    """A tuning file: one parameter set is searched for several experiments, each with equal
    weight."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="short name; the study is written to results/tuning/NAME",
        examples=["all_italy"],
    )
    description: str = Field(default="", description="what it is, in a line")
    tuning: Tuning = Field(default=Tuning(), description="settings of the search")
    experiments: tuple[str, ...] = Field(
        min_length=1,
        description="YAML files of experiments, relative to this one",
        examples=[["../paper/run01_italy_ml.yaml", "../paper/run02_italy_sl.yaml"]],
    )


@dataclass(frozen=True)
class Fleet:
    """The drives of a fleet, on which one parameter set is searched.

    - experiment: what is put on them, and written with what is found.
    - parts: the numbers of the drives that are held out together, in turn.
    - tags: of each drive, by name.
    - drive_of: the drive of each row, see `fleet.drives_of`.
    """

    experiment: Experiment
    parts: tuple[tuple[int, ...], ...]
    tags: tuple[Mapping[str, str], ...]
    drive_of: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """A study to do: which experiments are tuned together, and how.

    - tuning: the settings of the search.
    - source: the YAML, for messages.
    - fleet: where the experiments are one on each drive of a fleet; all frames count alike then,
      and else all experiments.
    """

    name: str
    description: str
    experiments: tuple[Experiment, ...]
    tuning: Tuning
    source: str
    fleet: Fleet | None = None

    @property
    def settings(self) -> Settings:
        """How the study is run, checked."""
        given, where = self.tuning.objective, f"{self.source}: tuning"
        names = tuple(check_objective(name, f"{where}.objective") for name in given)
        if len(set(names)) < len(names):
            raise InputError(f"{where}.objective: a score is named twice")
        sampler = check_sampler(self.tuning.sampler, names, f"{where}.sampler")
        return Settings(names, sampler, self.tuning.trials or TRIALS, self.tuning.seed)

    @property
    def run(self) -> int | None:
        """The paper's run that is tuned, if it is one."""
        return paper_run(self.experiments[0]) if len(self.experiments) == 1 else None


@dataclass(frozen=True)
class Problem:
    """A plan whose recordings were read.

    - drives: a recording and its model for each experiment.
    - spaces: a search space for each drive. Their dimensions are the same; the values of the
      parameters that are not searched may differ.
    """

    plan: Plan
    settings: Settings
    drives: tuple[Drive, ...]
    spaces: tuple[SearchSpace, ...]

    @property
    def space(self) -> SearchSpace:
        """The dimensions that are searched."""
        return self.spaces[0]

    @property
    def parts(self) -> Sequence[tuple[int, ...]]:
        """The numbers of the drives of a fleet that are held out together; none for others."""
        return () if self.plan.fleet is None else self.plan.fleet.parts


def load_plan(path: str | Path, overrides: Overrides = ()) -> Plan:
    """Read an experiment, or a tuning file. Raises InputError, one line, as
    `load_experiment`."""
    path = experiment_path(path)
    content = load_yaml(path, overrides)
    if "experiments" not in content:
        return plan_of(make_experiment(content, path.parent, str(path)))
    named = validated(TuningFile, content, str(path))
    found = []
    for entry in named.experiments:
        with problems_in(f"{path}: experiments"):
            found.append(load_experiment(path.parent / entry))
    return Plan(named.name, named.description, tuple(found), named.tuning, str(path))


def plan_of(experiment: Experiment) -> Plan:
    """The plan of an experiment by itself, with its own `tuning` section."""
    tuning = experiment.tuning or Tuning()
    name, said, source = experiment.name, experiment.description, experiment.source
    return Plan(name, said, (experiment,), tuning, source)


def paper_plans(numbers: Sequence[int]) -> list[Plan]:
    """Return a plan per run of the paper, with the defaults of a search."""
    # The frames that a run's own experiment never fits are left out with every plan.
    return [replace(load_plan(paper_experiment(n)), tuning=Tuning()) for n in numbers]


def together(plans: Sequence[Plan]) -> Plan:
    """One plan for the experiments of several; the tuning section is the first one's."""
    names = [plan.name for plan in plans]
    return Plan(
        "+".join(names) if len("+".join(names)) < 100 else f"{names[0]}+{len(names) - 1}",
        f"one parameter set for {', '.join(names)}",
        tuple(e for plan in plans for e in plan.experiments),
        plans[0].tuning,
        plans[0].source,
    )


def with_options(plan: Plan, options: Mapping[str, Any]) -> Plan:
    """Replace settings of a plan's search.

    - options: keys of the `tuning` section; those that are None stay as they are, `parameters` are
      added to those of the plan one by one.
    """
    content = plan.tuning.model_dump()
    parameters = {**content["parameters"], **options.get("parameters", {})}
    content |= {key: value for key, value in options.items() if value is not None}
    content["parameters"] = parameters
    return replace(plan, tuning=validated(Tuning, content, plan.source))


def paper_run(experiment: Experiment) -> int | None:
    """The number of the paper's run that an experiment is, by its name."""
    match = re.fullmatch(r"run(\d\d)_(italy|spain)_[a-z]+", experiment.name)
    return int(match.group(1)) if match and 1 <= int(match.group(1)) <= 10 else None


def make_problem(plan: Plan) -> Problem:
    """Read the recordings and make the search space.

    Raises InputError for whatever does not fit: unknown names, bounds, other parameters in one of
    the experiments, the same recording twice.
    """
    _ = plan.settings  # Checked before anything is read.
    never_fit = plan.tuning.never_fit
    needs = "a search needs it"
    drives = []
    for experiment in plan.experiments:
        # The drives of a fleet have one YAML.
        of_drive = nullcontext() if plan.fleet is None else problems_in(experiment.name)
        with of_drive:
            check_filter(experiment)
            drives.append(load_drive(experiment, needs_truth=needs, never_fit=never_fit))
    specs = [declared_parameters(drive.model.rule, drive.model.graph) for drive in drives]
    for drive, declared in zip(drives, specs, strict=True):
        if declared != specs[0]:
            raise InputError(
                f"{drive.experiment.source}: declares other parameters than"
                f" {drives[0].experiment.source}; one set for both needs the same plugins"
            )
    return problem_of(plan, drives)


def problem_of(plan: Plan, drives: Sequence[Drive]) -> Problem:
    """The search space of recordings that were read. Raises InputError as `make_problem` does."""
    spaces = tuple(_space(plan, drive.experiment, drive.model) for drive in drives)
    _check_alike([drive.experiment for drive in drives], spaces)
    return Problem(plan, plan.settings, tuple(drives), spaces)


def check_tuning(experiment: Experiment, model: Model) -> None:
    """Check the settings of a search that an experiment has of its own. Raises InputError for names
    of scores, samplers and parameters that there are not, and for bounds that do not fit."""
    tuning = experiment.tuning
    if tuning is None:
        return
    plan = plan_of(experiment)
    _ = plan.settings
    if tuning.parameters:
        _space(plan, experiment, model)


def _check_alike(experiments: Sequence[Experiment], spaces: Sequence[SearchSpace]) -> None:
    for experiment, space in zip(experiments, spaces, strict=True):
        if space.dimensions != spaces[0].dimensions:
            raise InputError(
                f"{experiment.source}: has other lanes than {experiments[0].source}: a parameter"
                " with one value per lane cannot be shared; fix it, or tune them apart"
            )


def _space(plan: Plan, experiment: Experiment, model: Model) -> SearchSpace:
    searched = plan.tuning.search
    where = f"{plan.source}: tuning.parameters"
    # What both declare belongs to the graph, as in `declared_parameters`.
    of_graph = {spec.name for spec in getattr(model.graph, "PARAMETERS", ())}
    specs = [
        spec
        if ("graph" if spec.name in of_graph else "evidence") in searched
        else replace(spec, search=None)
        for spec in declared_parameters(model.rule, model.graph)
    ]
    current = dict(model.parameters)
    if "detector" in searched:
        of_detector, values = searched_of_detector(experiment)
        specs += of_detector
        current |= values
    return make_space(specs, current, plan.tuning.parameters, model.n_lanes, where)


def parameters_at(problem: Problem, point: Point) -> list[dict[str, Value]]:
    """Per drive, every declared parameter's value at a point."""
    return [to_parameters(space, point) for space in problem.spaces]


def scorer(problem: Problem, is_used: Sequence[BoolArray]) -> Score:
    """The objective of a study: scores of a point over the frames that are used, per drive (K,)."""

    def score(point: Point) -> list[float]:
        sets = parameters_at(problem, point)
        together = problem.plan.fleet is not None
        objectives = problem.settings.objectives
        return scores_of(problem.drives, sets, is_used, objectives, together=together)

    return score


def starting_points(problem: Problem) -> tuple[list[Point], list[str]]:
    """Return the points that a study tries first, and notes about those that lie out of bounds.

    They are the current values of each experiment, and for a run of the paper the recovered and
    the published ones before them.
    """
    if problem.plan.tuning.from_scratch:
        return [], []
    named: list[tuple[str, Mapping[str, Value]]] = []
    for drive in problem.drives:
        number = paper_run(drive.experiment)
        if number is not None:
            specs = declared_parameters(drive.model.rule, drive.model.graph)
            known = {spec.name for spec in specs}
            for which in ("recovered", "published"):
                values = parameters_for(load_published()[number], which)
                kept = {k: v for k, v in values.items() if k in known}
                merged = {**drive.experiment.parameters, **kept}
                named.append((which, resolve_parameters(specs, merged, drive.n_lanes)))
        named.append(("current", drive.model.parameters))
    if "detector" in problem.plan.tuning.search:
        # The detector's values are those of the first recording; with one recording, its own.
        _, seen = searched_of_detector(problem.drives[0].experiment)
        named = [(which, {**parameters, **seen}) for which, parameters in named]
    points: list[Point] = []
    notes = []
    for which, parameters in named:
        point = to_point(problem.space, parameters)
        if point is None:
            notes.append(
                f"{NOTE}the {which} values lie outside of the bounds and are not tried first"
            )
        elif point not in points:
            points.append(point)
    return points, notes
