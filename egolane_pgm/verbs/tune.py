"""The verb `tune`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from annotated_types import Ge

from egolane_pgm.loading import ExperimentLike, merge, parse_overrides
from egolane_pgm.studies.study import Study
from egolane_pgm.tools import options
from egolane_pgm.tools.options import Option, StrPath
from egolane_pgm.verbs.studied import fit_study
from egolane_pgm.verbs.studied import summary as summary

EXAMPLES = (
    "egolane tune drive/experiment.yaml --trials 300",
    "egolane tune experiments/quickstart.yaml -p sigma1=[0.1,0.5] --set fit.sampler=tpe --jobs 2",
    "egolane tune X.yaml --profile sigma1 --profile p1 --jobs 2",
    "egolane tune experiments/quickstart.yaml --table drives.csv --by-tag weather",
)


def tune(
    experiments: Annotated[ExperimentLike | Sequence[Any], Option("EXPERIMENT...")],
    *,
    graph: options.Graph = None,
    ground_truth: options.TruthInMemory = None,
    n_lanes: options.LanesInMemory = None,
    trials: Annotated[int | None, Ge(1)] = None,
    parameter: Annotated[options.Overrides, Option("NAME=VALUE", names=("-p",))] = (),
    profile: Annotated[Sequence[str], Option("NAME")] = (),
    overrides: options.Overrides = (),
    folds: options.Folds = None,
    table: options.TableOfRuns = None,
    by_tag: options.ByTag = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/tuning/*")] = None,
    jobs: options.Jobs = 1,
    cluster: options.Cluster = None,
    storage: Annotated[str | None, Option("URL", envvar="EGOLANE_STORAGE")] = None,
) -> Study:
    """Search parameters; score them on held-out frames.

    Several experiments share one parameter set and have equal weight; with a table all frames of
    its rows have equal weight. Each fold is scored with the parameters of a search in the others.
    Studies are Optuna's, in study.journal of the directory or in a storage. A repeated command
    resumes them; the same command on other machines with the same storage joins in.

    - experiments: one, or a list: experiments, results, studies or lines.
    - graph: another graph: a name or a file; in Python also a module or a pgmpy network.
    - ground_truth, n_lanes: of lines in memory, as for `run`; of several a list of ground truths.
    - trials: total of a study, by default 3000.
    - parameter: narrow the range of a parameter, p1=[0.5,1], or fix it, p1=0.9.
    - profile: a parameter whose profile is made: at each of some values all others are searched
      again, and values that the frames rule out are listed. Repeatable.
    - overrides: override a key of the YAML, e.g. fit.objective=log_loss, fit.sampler=tpe,
      fit.seed=1.
    - folds: number of folds, by default 5, 0 for none: blocks of each drive; with a table, groups
      of drives.
    - table: table of runs: columns are YAML keys (recording.path, n_lanes) and tag.X.
    - by_tag: with a table: a fold for each value of tag.NAME.
    - out: directory of the study. A `*` in it is the experiment's name.
    - jobs: processes that share the searches with and without each fold.
    - cluster: Dask cluster for these searches.
    - storage: a database that machines share, as a URL of Optuna's.

    Returns a `Study`; writes files only with `out`. Raises InputError, before the search, if the
    arguments do not fit.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> only = {"sigma1": [0.2, 0.5], "bonus_value": 3}
    >>> study = ego.tune(experiment, trials=3, folds=0, parameter=only)
    >>> study.fitted["bonus_value"], len(study.trials)
    (3.0, 3)
    """
    fit: dict[str, Any] = {} if trials is None else {"trials": trials}
    if parameter:
        fit["parameters"] = parse_overrides(parameter, "parameter")
    study = fit_study(
        "tune",
        experiments,
        overrides=merge(parse_overrides(overrides), {"fit": fit}) if fit else overrides,
        graph=graph,
        ground_truth=ground_truth,
        n_lanes=n_lanes,
        table=table,
        by_tag=by_tag,
        folds=folds,
        out=out,
        storage=storage,
        profile=profile,
        jobs=jobs,
        cluster=cluster,
    )
    if study.directory is not None:
        from egolane_pgm.views.studies import draw_study

        draw_study(study.directory)
    return study
