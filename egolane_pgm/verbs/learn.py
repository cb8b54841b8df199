"""The verb `learn`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from egolane_pgm.loading import ExperimentLike
from egolane_pgm.studies.study import Study
from egolane_pgm.tools import options
from egolane_pgm.tools.options import Option, StrPath
from egolane_pgm.verbs.studied import fit_study
from egolane_pgm.verbs.studied import summary as summary

EXAMPLES = (
    "egolane learn drive/experiment.yaml",
    "egolane learn experiments/quickstart.yaml --set fit.labels=false",
    "egolane learn X.yaml --set fit.learns=parameters",
)


def learn(
    experiments: Annotated[ExperimentLike | Sequence[Any], Option("EXPERIMENT...")],
    *,
    graph: options.Graph = None,
    ground_truth: options.TruthInMemory = None,
    n_lanes: options.LanesInMemory = None,
    overrides: options.Overrides = (),
    out: Annotated[StrPath | None, Option("DIR", default="results/learning/*")] = None,
    folds: options.Folds = None,
    table: options.TableOfRuns = None,
    by_tag: options.ByTag = None,
    jobs: options.Jobs = 1,
    cluster: options.Cluster = None,
) -> Study:
    """Fit a model to its recording; write the fitted experiment and its held-out scores.

    An evidence rule that can learn (line_geometry) learns its parameters from the labels. With any
    other rule the tables of the graph are learned, or its parameters (fit.learns=parameters). By
    default they minimise the log-loss of the lane, over trusted frames without a lane change, with
    a prior around their start. With fit.objective=log_evidence, or from lines alone
    (fit.labels=false), they make lines and labels most probable: tables by EM, with a prior,
    parameters without. The best of fit.trials starts is kept. Each fold is scored with a fit to the
    frames of the other folds.

    - experiments: one, or a list: experiments, results, studies or lines.
    - graph: another graph: a name or a file; in Python also a module or a pgmpy network.
    - ground_truth, n_lanes: of lines in memory, as for `run`; of several a list of ground truths.
    - overrides: override a key of the YAML, e.g. fit.labels=false.
    - out: directory of the study. A `*` in it is the experiment's name.
    - folds: number of folds, by default 5, 0 for none: blocks of each drive; with a table, groups
      of drives.
    - table: table of runs: columns are YAML keys (recording.path, n_lanes) and tag.X.
    - by_tag: with a table: a fold for each value of tag.NAME.
    - jobs: processes that share the fits.
    - cluster: Dask cluster for the fits.

    Returns a `Study`: `model.network` is the learned graph in pgmpy. Writes files only with
    `out`. Raises InputError for a model without learnable parameters or tables.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 600]})
    >>> study = ego.learn(experiment, overrides={"fit.labels": False}, folds=2)
    >>> study.held_out
    Result('quickstart': 600 frames, accuracy 0.880 ...; held out, causal)
    >>> sorted(study.fitted)[:1]
    ['tables.DetectorOutput']
    """
    return fit_study(
        "learn",
        experiments,
        overrides=overrides,
        graph=graph,
        ground_truth=ground_truth,
        n_lanes=n_lanes,
        table=table,
        by_tag=by_tag,
        folds=folds,
        out=out,
        jobs=jobs,
        cluster=cluster,
    )
