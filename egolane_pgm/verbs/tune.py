"""The verb `tune`."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge
from joblib import cpu_count

from egolane_pgm.comparing.placing import parts_of_fleet
from egolane_pgm.drive import as_name
from egolane_pgm.experiment import Given, Overrides, load_experiment
from egolane_pgm.fleet import drives_of, experiments_of
from egolane_pgm.paper import Runs, parse_runs
from egolane_pgm.tools.files import temporary_folder
from egolane_pgm.tools.progress import bar
from egolane_pgm.tuning import plan as planning
from egolane_pgm.tuning import study as studies
from egolane_pgm.tuning.result import One, Study
from egolane_pgm.tuning.space import described
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import (
    Blocks,
    ByTag,
    Fleet,
    Jobs,
    Option,
    Progress,
    Seed,
    StrPath,
    keys_of,
    path_of,
    several_of,
)
from egolane_pgm.views.study_figures import draw_study
from egolane_pgm.views.tables import line_width

EXAMPLES = (
    "egolane tune drive/experiment.yaml --trials 300",
    "egolane tune experiments/quickstart.yaml -p sigma1=[0.1,0.5] --sampler tpe --workers 2",
    "egolane tune experiments/quickstart.yaml --fleet drives.csv --by-tag weather",
)


def tune(
    experiments: Annotated[Given | Sequence[Given], Option("EXPERIMENT...", many=True)] = (),
    *,
    runs: Annotated[Runs | None, Option("TEXT")] = None,
    trials: Annotated[int | None, Ge(1), Option(said="3000")] = None,
    objective: Annotated[str | Sequence[str], Option(many=True, said="accuracy")] = (),
    sampler: Annotated[str | None, Option(said="evolution")] = None,
    seed: Annotated[Seed | None, Option(said="0")] = None,
    parameter: Annotated[
        Mapping[str, Any] | None,
        Option("NAME=VALUE", names=("-p",), example="p1=[0.5,1] or p1=0.9"),
    ] = None,
    blocks: Annotated[Blocks | None, Option(said="5")] = None,
    in_sample_only: bool = False,
    together: bool = False,
    fleet: Fleet = None,
    by_tag: ByTag = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/tuning")] = None,
    figures: bool = True,
    workers: Annotated[int | None, Ge(1)] = None,
    jobs: Annotated[
        Jobs | None, Option(said="the cores", help="Processes that share the studies.")
    ] = None,
    storage: Annotated[str | None, Option("URL", envvar="EGOLANE_STORAGE")] = None,
    overrides: Overrides = (),
    progress: Progress = None,
) -> Study:
    """Search parameters; report what they are worth on frames that they have not seen.

    EXPERIMENT is an experiment, or a tuning file. Every study is Optuna's, kept in study.journal of
    its directory or in a storage; a repeated command goes on where it stopped. Other machines, or
    terminals, join in it by giving the same command.

    With a fleet one parameter set is searched for all drives of a table; all their frames count
    alike.

    - experiments: one, or a list: experiments, or paths of experiments and of tuning files.
    - runs: runs of the paper, e.g. 1-10, instead.
    - trials: total of a study.
    - objective: a score by name; several times for a Pareto front.
    - sampler: one of evolution, tpe, cma-es, random; nsga2 for several objectives.
    - seed: of the sampler.
    - parameter: narrow, p1=[0.5,1], or fix, p1=0.9.
    - blocks: blocks held out in turn; of a fleet parts of its drives.
    - in_sample_only: no nested studies: in-sample scores only.
    - together: one parameter set for all the experiments.
    - fleet: a table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...
    - by_tag: with a fleet: hold out the drives with each value of tag.NAME in turn.
    - out: a directory per study is made in it.
    - figures: draw figures/ in each study's directory.
    - workers: processes that share the trials of one study.
    - jobs: processes that share the studies. None: the processor's cores, or one where nothing is
      written.
    - storage: a database that machines share, as Optuna names it; also EGOLANE_STORAGE. By default
      study.journal in the study's directory.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns a `Study`. Without `out` the trials of a search that is stopped are lost. Raises
    InputError for whatever does not fit, before anything is searched.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> only = {"sigma1": [0.2, 0.5], "bonus_value": 3}
    >>> study = ego.tune(experiment, trials=3, in_sample_only=True, parameter=only)
    >>> "bonus_value" in study.best
    False
    """
    if workers is not None and jobs is not None:
        raise InputError("workers: share one study, jobs several; take one of the two")
    if workers is None and jobs is None:
        jobs = cpu_count() if out is not None else 1
    if in_sample_only and blocks is not None:
        raise InputError("in_sample_only: does not go with blocks")
    changed = {
        "trials": trials,
        "objective": (objective,) if isinstance(objective, str) else tuple(objective) or None,
        "sampler": sampler,
        "seed": seed,
        "blocks": blocks,
        "parameters": keys_of(parameter, "parameter", "{'p1': [0.5, 1], 'p2': 0.9}"),
    }
    given = several_of(experiments)
    plans = [planning.with_options(p, changed) for p in _plans(given, runs, overrides)]
    if fleet is not None:
        if runs or together:
            raise InputError("fleet: its drives are tuned together; leave out runs and together")
        plans = [on_fleet(p, fleet, by_tag, overrides) for p in plans]
    elif by_tag is not None:
        raise InputError("by_tag: goes with a fleet")
    if together:
        plans = [planning.together(plans)]
    _check_names(plans)
    with (
        nullcontext(Path(path_of(out, "out"))) if out is not None else temporary_folder() as folder
    ):
        held_out = "none" if in_sample_only else "blocks"
        searches = [studies.prepare(plan, folder / plan.name, held_out, storage) for plan in plans]
        if out is not None:
            _announce(searches)
        try:
            found = _search_all(searches, jobs or 1, workers, progress)
        except KeyboardInterrupt:
            if out is None:
                raise
            place = "the storage" if storage else _listed([made.directory for made in searches])
            raise KeyboardInterrupt(
                f"complete trials are kept in {place}; repeat the command to go on"
            ) from None
        if out is not None and figures:
            for made in bar(searches, progress, desc="figures", unit="study"):
                draw_study(made.directory)
    return found


def says(done: Study, given: Mapping[str, Any]) -> str:
    """Where the studies are."""
    folders = _listed([Path(given["out"], name) for name in done.names])
    return f"studies: {folders}; best.yaml: run it, or `include:` it"


def _listed(folders: Sequence[Path]) -> str:
    return ", ".join(map(str, folders[:3])) + (", ..." if len(folders) > 3 else "")


def _announce(searches: Sequence[studies.Search]) -> None:
    """Say on standard error what is searched, those of equal studies once."""
    alike: dict[str, list[str]] = {}
    for made in searches:
        for name, space in made.task.spaces.items():
            searched, fixed = described(space)
            text = _wrapped(f"{len(space)} numbers are searched", searched)
            text += _wrapped(f"{space.n_fixed} are held fixed", fixed)
            alike.setdefault(text, []).append(name)
    for text, names in alike.items():
        title = f"{', '.join(names)}:\n" if len(alike) > 1 else ""
        sys.stderr.write(title + text)


def _wrapped(title: str, items: Sequence[str]) -> str:
    """Lines that break between the items."""
    text = f"{title}: " + ", ".join(item.replace(" ", "\0") for item in items)
    return textwrap.fill(text, line_width(), subsequent_indent="  ").replace("\0", " ") + "\n"


def on_fleet(
    plan: planning.Plan, fleet: str | os.PathLike[str], by_tag: str | None, overrides: Overrides
) -> planning.Plan:
    """The plan for one parameter set for all drives of a fleet; for a fleet of one drive that of
    its recording."""
    if len(plan.experiments) > 1:
        raise InputError(f"{plan.source}: fleet: goes with one experiment; the table has drives")
    (base,) = plan.experiments
    drives, experiments = experiments_of(base, fleet, overrides)
    # The ids of frames that are never fitted are those of the base's own recording.
    found = replace(
        plan,
        name=as_name(f"{plan.name}_{Path(fleet).stem}"),
        experiments=tuple(experiments),
        tuning=plan.tuning.model_copy(update={"never_fit": ()}),
    )
    if len(drives) == 1:
        return found
    of = drives_of(drives, experiments)
    parts = parts_of_fleet(drives, of, plan.tuning.blocks, by_tag)
    written = base.model_copy(update={"n_lanes": experiments[0].n_lanes})
    tags = tuple(drive.tags for drive in drives)
    return replace(found, fleet=planning.Fleet(written, parts, tags, tuple(of)))


def _plans(
    experiments: Sequence[Any], runs: Runs | None, overrides: Overrides
) -> list[planning.Plan]:
    if bool(experiments) == bool(runs):
        raise InputError("tune: name experiments, or runs of the paper: runs 1-10")
    if runs:
        if overrides:
            raise InputError("overrides: go with an experiment's YAML, not with runs")
        return planning.paper_plans(parse_runs(runs))
    return [_plan(given, overrides) for given in experiments]


def _plan(given: Any, overrides: Overrides) -> planning.Plan:
    if isinstance(given, (str, os.PathLike)):
        return planning.load_plan(Path(given), overrides)
    return planning.plan_of(load_experiment(given, overrides))


def _check_names(plans: Sequence[planning.Plan]) -> None:
    names = [plan.name for plan in plans]
    for plan in plans:
        if names.count(plan.name) > 1:
            raise InputError(f"{plan.source}: another experiment has the name {plan.name} too")


def _search_all(
    searches: Sequence[studies.Search], jobs: Jobs, workers: int | None, progress: bool | None
) -> Study:
    """Do searches that were prepared."""
    with bar(None, progress, total=studies.n_trials(searches), unit="trial") as shows:

        def advance(label: str, more: int, best: float) -> None:
            shows.set_description(label, refresh=False)
            shows.set_postfix(best=f"{best:.4f}", refresh=False)
            shows.update(more)

        done = studies.tune(searches, jobs=jobs, workers=workers, progress=advance)
    both = zip(searches, done, strict=True)
    return Study(tuple(One(study, made.trials, made.experiments) for made, study in both))
