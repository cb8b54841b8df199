"""The verb `tune`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from annotated_types import Ge

from egolane_pgm.loading import ExperimentLike, Overrides
from egolane_pgm.paper import known_parameters
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import declared_parameters
from egolane_pgm.studies.study import Study, run_study, tuning_of
from egolane_pgm.verbs.given import (
    ByTag,
    Cluster,
    Graph,
    HeldOutBlocks,
    Jobs,
    Lines,
    Option,
    Progress,
    Seed,
    StrPath,
    TableOfRuns,
    Truth,
    keys_of,
)
from egolane_pgm.verbs.studied import Studied, open_studied, study_place
from egolane_pgm.verbs.studied import says as says

EXAMPLES = (
    "egolane tune drive/experiment.yaml --trials 300",
    "egolane tune experiments/quickstart.yaml -p sigma1=[0.1,0.5] --sampler tpe --jobs 2",
    "egolane tune experiments/quickstart.yaml --table drives.csv --by-tag weather",
)


def tune(
    experiments: Annotated[
        ExperimentLike | Lines | Sequence[Any], Option("EXPERIMENT...", many=True)
    ],
    *,
    n_lanes: int | None = None,
    ground_truth: Annotated[Truth | None, Option("FILE", hidden=True)] = None,
    graph: Graph = None,
    trials: Annotated[int | None, Ge(1), Option(said="3000")] = None,
    objective: Annotated[str | Sequence[str], Option(many=True, said="accuracy")] = (),
    sampler: Annotated[str | None, Option(said="evolution")] = None,
    seed: Annotated[Seed | None, Option(said="0")] = None,
    parameter: Annotated[
        Mapping[str, Any] | None,
        Option("NAME=VALUE", names=("-p",), example="p1=[0.5,1] or p1=0.9"),
    ] = None,
    blocks: Annotated[HeldOutBlocks | None, Option(said="5")] = None,
    table: TableOfRuns = None,
    by_tag: ByTag = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/tuning/*")] = None,
    figures: bool = True,
    jobs: Jobs = 1,
    cluster: Cluster = None,
    storage: Annotated[str | None, Option("URL", envvar="EGOLANE_STORAGE")] = None,
    overrides: Overrides = (),
    progress: Progress = None,
) -> Study:
    """Search parameters; score them on frames that the search has not seen.

    The parameters of several experiments are searched together, each experiment with equal weight;
    with a table those of its rows, each frame with equal weight. Each block is scored with the
    parameters of a search without it. Studies are Optuna's, kept in study.journal of the directory
    or in a storage; a repeated command resumes them, and other machines or terminals that give the
    same command join in.

    - experiments: one, or a list: experiments, results, or lines.
    - n_lanes: number of lanes of the road.
    - ground_truth: a DataFrame with frame_id, lane and crossing, or a file.
    - graph: another graph; in Python also a module or a pgmpy network.
    - trials: total of a study.
    - objective: a score by name; several times for a Pareto front.
    - sampler: one of evolution, tpe, cma-es, random; nsga2 for several objectives.
    - seed: of the sampler.
    - parameter: narrow, p1=[0.5,1], or fix, p1=0.9.
    - blocks: blocks held out in turn, 0 for none; of a table parts of its drives.
    - table: table of runs: columns are YAML keys (recording.path, n_lanes) and tag.X.
    - by_tag: with a table: hold out the drives with each value of tag.NAME in turn.
    - out: directory of the study. A `*` in it is the experiment's name.
    - figures: draw figures/ in the directory.
    - jobs: processes that share the searches with and without each block.
    - cluster: Dask cluster for these searches.
    - storage: a database that machines share, as a URL of Optuna's.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    - progress: whether a bar is shown; None for in a terminal.

    Returns a `Study`. Without `out` nothing is written. Raises InputError, before anything is
    searched, for whatever does not fit.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> only = {"sigma1": [0.2, 0.5], "bonus_value": 3}
    >>> study = ego.tune(experiment, trials=3, blocks=0, parameter=only)
    >>> study.fitted["bonus_value"], len(study.trials)
    (3.0, 3)
    """
    given = open_studied(
        experiments,
        overrides=overrides,
        n_lanes=n_lanes,
        ground_truth=ground_truth,
        graph=graph,
        table=table,
        by_tag=by_tag,
        blocks=blocks,
    )
    changes: dict[str, Any] = {
        "trials": trials,
        "objective": (objective,) if isinstance(objective, str) else tuple(objective) or None,
        "sampler": sampler,
        "seed": seed,
        "parameters": keys_of(parameter, "parameter", "{'p1': [0.5, 1], 'p2': 0.9}"),
    }
    place = study_place(out, given)
    study = run_study(
        given.drives,
        "tune",
        given.folds,
        name=given.name,
        experiments=given.experiments,
        tuning=tuning_of(given.drives[0].experiment, **changes),
        starts=starting_points(given),
        storage=storage,
        directory=place,
        pooled=table is not None,
        notes=given.notes,
        jobs=jobs,
        cluster=cluster,
        progress=progress,
    )
    if place is not None and figures:
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
            kept = {name: value for name, value in values.items() if name in known}
            merged = {**drive.experiment.model_parameters, **kept}
            starts.append(resolve_parameters(specs, merged, drive.model.n_lanes))
        starts.append(dict(model.parameters))
    return starts
