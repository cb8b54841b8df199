"""The verb `tune`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from annotated_types import Ge

from egolane_pgm.loading import ExperimentLike, merge, parse_overrides
from egolane_pgm.paper import known_parameters
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.studies.study import Study, run_study
from egolane_pgm.verbs.options import (
    ByTag,
    Cluster,
    Folds,
    Graph,
    Hidden,
    Jobs,
    Lines,
    Option,
    Overrides,
    Progress,
    StrPath,
    TableOfRuns,
    Truth,
    keys_of,
    place_of,
)
from egolane_pgm.verbs.studied import Studied, open_studied
from egolane_pgm.verbs.studied import summary as summary

EXAMPLES = (
    "egolane tune drive/experiment.yaml --trials 300",
    "egolane tune experiments/quickstart.yaml -p sigma1=[0.1,0.5] --set fit.sampler=tpe --jobs 2",
    "egolane tune experiments/quickstart.yaml --table drives.csv --by-tag weather",
)


def tune(
    experiments: Annotated[
        ExperimentLike | Lines | Sequence[Any], Option("EXPERIMENT...", many=True)
    ],
    *,
    n_lanes: Annotated[int | None, Hidden] = None,
    ground_truth: Annotated[Truth | None, Hidden] = None,
    graph: Graph = None,
    trials: Annotated[int | None, Ge(1), Option(shown="3000")] = None,
    parameter: Annotated[
        Mapping[str, Any] | None,
        Option("NAME=VALUE", names=("-p",), example="p1=[0.5,1] or p1=0.9"),
    ] = None,
    overrides: Overrides = (),
    folds: Folds = None,
    table: TableOfRuns = None,
    by_tag: ByTag = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/tuning/*")] = None,
    jobs: Jobs = 1,
    cluster: Cluster = None,
    storage: Annotated[str | None, Option("URL", envvar="EGOLANE_STORAGE")] = None,
    progress: Progress = None,
) -> Study:
    """Search parameters; score them on held-out frames.

    Several experiments share one parameter set and have equal weight; with a table all frames of
    its rows have equal weight. Each fold is scored with the parameters of a search without it.
    Studies are Optuna's, in study.journal of the directory or in a storage. A repeated command
    resumes them; the same command on other machines with the same storage joins in.

    - experiments: one, or a list: experiments, results, or lines.
    - n_lanes: number of lanes of the road, for lines.
    - ground_truth: a DataFrame with frame_id, lane and crossing, or a file.
    - graph: another graph: a name or a file; in Python also a module or a pgmpy network.
    - trials: total of a study.
    - parameter: narrow the range of a parameter, p1=[0.5,1], or fix it, p1=0.9.
    - overrides: override a key of the YAML, e.g. fit.objective=log_loss, fit.sampler=tpe,
      fit.seed=1.
    - folds: number of folds, 0 for none: blocks of each drive; with a table, groups of drives.
    - table: table of runs: columns are YAML keys (recording.path, n_lanes) and tag.X.
    - by_tag: with a table: a fold for each value of tag.NAME.
    - out: directory of the study. A `*` in it is the experiment's name.
    - jobs: processes that share the searches with and without each fold.
    - cluster: Dask cluster for these searches.
    - storage: a database that machines share, as a URL of Optuna's.
    - progress: whether to show a bar; by default in a terminal only.

    Returns a `Study`; writes files only with `out`. Raises InputError, before the search, if the
    arguments do not fit.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> only = {"sigma1": [0.2, 0.5], "bonus_value": 3}
    >>> study = ego.tune(experiment, trials=3, folds=0, parameter=only)
    >>> study.fitted["bonus_value"], len(study.trials)
    (3.0, 3)
    """
    ranges = keys_of(parameter, "parameter", "{'p1': [0.5, 1], 'p2': 0.9}")
    fit = ({} if trials is None else {"trials": trials}) | (
        {"parameters": ranges} if ranges else {}
    )
    given = open_studied(
        experiments,
        overrides=merge(parse_overrides(overrides), {"fit": fit}) if fit else overrides,
        n_lanes=n_lanes,
        ground_truth=ground_truth,
        graph=graph,
        table=table,
        by_tag=by_tag,
        folds=folds,
    )
    place = place_of(out, given.name)
    study = run_study(
        given.drives,
        "tune",
        given.folds,
        name=given.name,
        experiments=given.experiments,
        starts=starting_points(given),
        storage=storage,
        directory=place,
        pooled=table is not None,
        notes=given.notes,
        jobs=jobs,
        cluster=cluster,
        progress=progress,
    )
    if place is not None:
        from egolane_pgm.views.studies import draw_study

        draw_study(place)
    return study


def starting_points(given: Studied) -> list[dict[str, Any]]:
    """The parameter sets that a search tries first: the paper's, then the current ones."""
    starts = []
    for drive in given.drives:
        model = drive.model
        specs = declared_parameters(model.rule, model.graph)
        known = {spec.name for spec in specs}
        for values in known_parameters(drive.experiment):
            merged = {**drive.experiment.parameters, **values}
            kept = {name: value for name, value in merged.items() if name in known}
            starts.append(resolve_parameters(specs, kept, model.n_lanes))
        starts.append(dict(model.parameters))
    return starts
